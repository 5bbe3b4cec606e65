"""The figures of a page: static drawings, and the same again that zoom where Bokeh is installed."""

import importlib.util
from html import escape

from matplotlib.figure import Figure

from onboard.ground.drawing import html, theme


class Gallery:
    """Converts figures to HTML, each with unique ids, and keeps them for the part that zooms."""

    def __init__(self) -> None:
        self._figures: list[Figure] = []

    def __call__(self, figure: Figure | None, caption: str) -> str:
        """A figure with its caption; nothing for None."""
        if figure is None:
            return ""
        number = len(self._figures)
        self._figures.append(figure)
        return html.figure(theme.svg(figure, escape(caption), f"f{number + 1}"), caption, number)

    def packed(self) -> dict[str, str]:
        """Bokeh's script and the figures as its documents; empty where Bokeh is not installed, or nothing is drawn."""
        if not self._figures or not zooms():
            return {}
        from onboard.ground.drawing import zoom

        return {"bokeh": zoom.script(), "figures": zoom.data(self._figures), "roles": zoom.roles()}


def zooms() -> bool:
    """Whether figures zoom: the ``zoom`` extra is installed."""
    return importlib.util.find_spec("bokeh") is not None
