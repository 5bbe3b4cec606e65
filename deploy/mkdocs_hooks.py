"""Hooks of the documentation site: formulas become MathML, names of pages become links, roles in docstrings go."""

import re
from pathlib import PurePosixPath
from typing import Any

from latex2mathml.converter import convert

_FENCE = re.compile(r"(^ *```.*?^ *```$)", re.DOTALL | re.MULTILINE)
_SPAN = re.compile(r"(`[^`\n]+`)")
_DISPLAY = re.compile(r"\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"(?<![\\$\w])\$([^$\n]+(?:\n[^$\n]+)?)\$(?!\w)")
_PAGE = re.compile(r"`(?:docs/)?(\w+\.md)`")


def on_page_markdown(markdown: str, page: Any, files: Any, **_: Any) -> str:
    """The page with MathML for ``$..$`` and ``$$..$$`` outside code, and links for the names of other pages."""
    pages = {PurePosixPath(file.src_uri).name for file in files.documentation_pages()} - {page.file.src_uri}

    def link(found: re.Match[str]) -> str:
        return f"[{found[0]}]({found[1]})" if found[1] in pages else found[0]

    def prose(text: str) -> str:
        parts = _SPAN.split(_DISPLAY.sub(lambda it: "\n\n" + convert(it[1], display="block") + "\n\n", text))
        parts[::2] = [_INLINE.sub(lambda it: f"<span>{convert(it[1])}</span>", part) for part in parts[::2]]
        return _PAGE.sub(link, "".join(parts))

    parts = _FENCE.split(markdown)
    parts[::2] = [prose(part) for part in parts[::2]]
    return "".join(parts)


def on_page_content(html: str, **_: Any) -> str:
    """The page without the roles of reStructuredText that docstrings have before names."""
    return re.sub(r":(?:class|func|meth|mod|data|attr):(?=<code>)", "", html)
