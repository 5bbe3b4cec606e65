"""Hooks of the documentation site.

Formulas become MathML, names of pages become links, roles in docstrings go, the first use of each word of the
glossary on a page leads to its row there, and cells of wide tables of text carry the head of their column.
"""

import re
from pathlib import Path, PurePosixPath
from typing import Any

from latex2mathml.converter import convert

_FENCE = re.compile(r"(^ *```.*?^ *```$)", re.DOTALL | re.MULTILINE)
_SPAN = re.compile(r"(`[^`\n]+`)")
_DISPLAY = re.compile(r"( *)\$\$(.+?)\$\$", re.DOTALL)
_INLINE = re.compile(r"(?<![\\$\w])\$([^$\n]+(?:\n[^$\n]+)?)\$(?!\w)")
_KEPT = re.compile(  # of a page: code, links, HTML with its content where it is a formula, headings
    r"(^ *```.*?^ *```$|`[^`\n]+`|!?\[[^\]]*\]\([^)]*\)|<math.*?</math>|<[^>]+>|^#.*?$)", re.DOTALL | re.MULTILINE
)
_GLOSSARY = Path(__file__).resolve().parents[1] / "docs" / "glossary.md"
_EVERYDAY = {"answer", "left out", "lie", "mark", "named", "refused"}  # more often meant as everywhere than as there
_LEVELS = {"good", "weak", "do not use"}  # levels where they are emphasised
_ROW = re.compile(r"^\| (?!word )([A-Za-z][\w ,]*) \|", re.MULTILINE)
_TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
_PAGE = re.compile(r"`(?:docs/)?(\w+\.md)`")


def on_page_markdown(markdown: str, page: Any, files: Any, **_: Any) -> str:
    """The page with MathML for ``$..$`` and ``$$..$$`` outside code, and links for the names of other pages."""
    pages = {PurePosixPath(file.src_uri).name for file in files.documentation_pages()} - {page.file.src_uri}

    def link(found: re.Match[str]) -> str:
        return f"[{found[0]}]({found[1]})" if found[1] in pages else found[0]

    def prose(text: str) -> str:
        parts = _SPAN.split(_DISPLAY.sub(lambda it: f"\n\n{it[1]}{convert(it[2], display='block')}\n\n", text))
        parts[::2] = [_INLINE.sub(lambda it: f"<span>{convert(it[1])}</span>", part) for part in parts[::2]]
        parts[1::2] = [part.replace(r"\|", "|") for part in parts[1::2]]  # escaped for GitHub
        return _PAGE.sub(link, "".join(parts))

    parts = _FENCE.split(markdown)
    parts[::2] = [prose(part) for part in parts[::2]]
    text = "".join(parts)
    if page.file.src_uri == _GLOSSARY.name:
        return _ROW.sub(lambda row: f'| <a id="{_anchor(row[1])}"></a>{row[1]} |', text)
    return with_words(text, "../" * page.file.src_uri.count("/") + _GLOSSARY.name)


def with_words(text: str, glossary: str) -> str:
    """The page with a link at the first use of each word of the glossary, outside code, links and headings."""
    rows = _ROW.findall(_GLOSSARY.read_text(encoding="utf-8"))
    anchors = {word: _anchor(row) for row in rows for word in row.split(", ") if word not in _EVERYDAY}
    patterns = {word: rf"(?<=\*){word}(?=\*)" if word in _LEVELS else re.escape(word) for word in anchors}
    longest_first = "|".join(patterns[word] for word in sorted(patterns, key=len, reverse=True))
    used = set[str]()

    def link(word: re.Match[str]) -> str:
        if word[0] in used:
            return word[0]
        used.add(word[0])
        return f"[{word[0]}]({glossary}#{anchors[word[0]]}){{ .word }}"

    parts = _KEPT.split(text)
    parts[::2] = [re.sub(rf"(?<![\w-])(?:{longest_first})(?![\w-])", link, part) for part in parts[::2]]
    return "".join(parts)


def _anchor(row: str) -> str:
    return re.sub(r"\W+", "-", row.lower())


def on_page_content(html: str, **_: Any) -> str:
    """The page without the roles that docstrings have before names, and with tables that fit on a phone."""
    return _TABLE.sub(_stacked, re.sub(r":(?:class|func|meth|mod|data|attr):(?=<code>)", "", html))


def _stacked(table: re.Match[str]) -> str:
    """A table of text with the head of its column at each cell, for ``site.css``; one of numbers is unchanged."""
    heads = [re.sub(r"<[^>]+>", "", head) for head in re.findall(r"<th>(.*?)</th>", table[0], re.DOTALL)]
    wide = len(heads) > 2 or re.search(r"<tr>\s*<td><code>[^<]{24}", table[0])
    if not wide or "<td style" in table[0]:
        return table[0]

    def row(cells: re.Match[str]) -> str:
        labels = iter(heads)
        return re.sub(r"<td>", lambda _: f'<td data-label="{next(labels)}">', cells[0])

    return re.sub(r"<tr>.*?</tr>", row, table[0], flags=re.DOTALL).replace("<table>", "<table data-stacked>", 1)
