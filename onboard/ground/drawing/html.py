"""HTML fragments; escapes all text that comes from a log."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path


class Cell(str):
    """A table cell with a class: ``n`` a number, ``good``, ``warn``, ``bad``, ``long`` text."""

    kind: str

    def __new__(cls, text: object, kind: str = "n") -> "Cell":
        """``text`` as a cell of ``kind``."""
        cell = super().__new__(cls, text)
        cell.kind = kind
        return cell


def table(headings: Sequence[str], rows: Iterable[Sequence[object]], *, listed: bool = False) -> str:
    """A table; cells are escaped and get the class of their :class:`Cell`. Empty without rows.

    One that is ``listed``, or has a ``long`` cell, is a list on a narrow screen, a cell a line behind its heading.
    """
    body = ""
    kinds = ["" for _ in headings]
    for row in rows:
        cells = [(cell, cell.kind if isinstance(cell, Cell) else "") for cell in row]
        kinds = [kind or old for (_, kind), old in zip(cells, kinds, strict=True)]
        named = zip(cells, headings, strict=True)
        body += "<tr>" + "".join(_cell(str(cell), kind, heading) for (cell, kind), heading in named) + "</tr>\n"
    if not body:
        return ""
    numeric = ["n" if kind.startswith("n") else "" for kind in kinds]
    head = "".join(f"<th{_class(kind)}>{escape(text)}</th>" for text, kind in zip(headings, numeric, strict=True))
    shape = _class("stacks" if listed or "long" in kinds else "")
    return f'<div class="scroll"><table{shape}><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table></div>\n'


def _cell(text: str, kind: str, heading: str) -> str:
    named = f' data-of="{escape(heading)}"' if text and heading else ""
    return f"<td{_class(kind)}{named}>{escape(text)}</td>"


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of text."""
    return f"<p{_class(kind)}>{escape(text)}</p>\n"


def figure(svg: str, caption: str, number: int) -> str:
    """A figure with its caption; ``number`` is its place among those that zoom."""
    told = f"<figcaption>{escape(caption)}</figcaption>"
    return f'<figure data-zoom="{number}"><div class="still">{svg}</div>{told}</figure>\n'


def card(what: str, value: str, unit: str, more: Iterable[str]) -> str:
    """A card with a headline number."""
    lines = "".join(f'<div class="more">{escape(line)}</div>' for line in more)
    number = f"{escape(value)} <small>{escape(unit)}</small>"
    return f'<div class="card"><div class="what">{escape(what)}</div><div class="value">{number}</div>{lines}</div>\n'


def verdicts(lines: Iterable[tuple[str, str]]) -> str:
    """``(kind, sentence)`` each: good, warn or bad."""
    items = "".join(f'<li class="{kind}">{escape(text)}</li>\n' for kind, text in lines)
    return f'<ul class="verdicts">\n{items}</ul>\n'


def write(output: Path, text: str) -> None:
    """Write a page, and the folders above it.

    Raises:
        OSError: it cannot be written.
    """
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(text, encoding="utf-8")


def page(title: str, head: str, sections: Sequence[tuple[str, str]], packed: Mapping[str, str]) -> str:
    """The whole document; empty sections are left out.

    Args:
        title: of the document.
        head: HTML before the sections.
        sections: heading and HTML.
        packed: what the page's script unpacks, gzip in base64, by id.
    """
    room = files("onboard.ground.drawing")
    style, player = (room.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "player.js"))
    shown = [(f"s{number}", name, body) for number, (name, body) in enumerate(sections) if body]
    links = "".join(f'<a href="#{key}">{escape(name)}</a>' for key, name, _ in shown)
    body = "".join(
        f'<section id="{key}"><h2>{escape(name)}</h2>\n{content}</section>\n' for key, name, content in shown
    )
    carried = "".join(f'<script type="text/plain" id="{key}">{text}</script>\n' for key, text in packed.items())
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        f"{head}<nav>{links}</nav>\n{body}{carried}<script>\n{player}</script>\n</body>\n</html>\n"
    )
