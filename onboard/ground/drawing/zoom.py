"""Figures that zoom: each matplotlib figure of a page once more for Bokeh, whose script the page carries once.

The static drawing stays in the page: it is what is seen without scripts, on paper, and without the ``zoom`` extra.
Colours are those of the roles in :mod:`onboard.ground.drawing.theme`; the page's script puts those of the screen in
their place. Texts are plain text models, never mark-up or mathematics. A glyph is added as one model: the plot's own
methods make it five times, for selections that no figure has.
"""

import base64
import gzip
import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.models import ColumnDataSource, FixedTicker, HoverTool, PlainText, Range1d
from bokeh.models.annotations import BoxAnnotation, Legend, LegendItem, Span, Title
from bokeh.models.axes import LinearAxis
from bokeh.models.glyphs import Line, MultiLine, Patches, Quad, Scatter
from bokeh.models.glyphs import Text as Words
from bokeh.plotting import figure as new_plot
from bokeh.resources import Resources
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator

from onboard.estimation.arrays import FloatArray
from onboard.ground.drawing.theme import COLOUR

_PIXELS_PER_IN, _AROUND = 96, 74
_LEGEND = 36
_DASH = {"--": "dashed", "-.": "dashdot", ":": "dotted"}
_TOOLS = "pan,box_zoom,wheel_zoom,reset,save"


def script() -> str:
    """Bokeh's script, gzip in base64."""
    return _packed("\n".join(Resources(mode="inline", components=["bokeh"], minified=True).js_raw))


def data(figures: Sequence[Figure]) -> str:
    """The figures as Bokeh documents, JSON, gzip in base64."""
    return _packed(json.dumps([_document(one) for one in figures], separators=(",", ":"), allow_nan=False))


def roles() -> str:
    """The roles and their colours in the figures."""
    return _packed(json.dumps(COLOUR))


def _packed(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


def _document(figure: Figure) -> dict[str, Any]:
    document = Document()
    plots: list[Any] = []
    shared: dict[Axes, Any] = {}
    for axes, twins in _panels(figure):
        peers = axes.get_shared_x_axes()
        first = next((one for one in shared if peers.joined(one, axes)), None)
        plot = _plot(axes, figure, None if first is None else shared[first])
        for twin in twins:
            _second(plot, twin)
        shared[axes] = plot.x_range
        _legend(plot, axes)
        plots.append(plot)
    with document.models.freeze():  # else all models are looked for anew with each plot
        for plot in plots:
            document.add_root(plot)
    wide = len({round(axes.get_position().x0, 3) for axes, _ in _panels(figure)}) == 1
    found: dict[str, Any] = {
        "columns": 1 if wide else 2,
        "roots": [plot.id for plot in plots],
        "doc": document.to_json(deferred=False),
    }
    return found


def _panels(figure: Figure) -> Iterator[tuple[Axes, list[Axes]]]:
    """Visible axes, each with those drawn over it."""
    shown = [axes for axes in figure.axes if axes.get_visible()]
    seen: dict[tuple[float, ...], tuple[Axes, list[Axes]]] = {}
    for axes in shown:
        place = tuple(np.round(axes.get_position().bounds, 4))
        if place in seen:
            seen[place][1].append(axes)
        else:
            seen[place] = axes, []
    yield from seen.values()


def _plot(axes: Any, figure: Figure, x_range: Any) -> Any:
    height = round(axes.get_position().height * figure.get_figheight() * _PIXELS_PER_IN) + _AROUND
    height += _LEGEND if axes.get_legend() is not None else 0
    low, high = axes.get_xlim()
    plot = new_plot(
        height=height,
        min_width=260,
        min_border_left=64,
        sizing_mode="stretch_width",
        tools=_TOOLS,
        active_drag="box_zoom",
        active_scroll=None,
        toolbar_location="right",
        x_axis_type=axes.get_xscale(),
        y_axis_type=axes.get_yscale(),
        x_range=x_range or Range1d(low, high),
        y_range=Range1d(*axes.get_ylim()),
        match_aspect=axes.get_aspect() != "auto",
        background_fill_color=None,
        border_fill_color=None,
        outline_line_color=None,
    )
    plot.title = Title(text=_plain(axes.get_title(loc="left")), text_color=COLOUR["ink"], text_font_size="13px")
    plot.toolbar.logo = None
    for axis, label in ((plot.xaxis[0], axes.get_xlabel()), (plot.yaxis[0], axes.get_ylabel())):
        _style(axis, label)
    for grid in plot.grid:
        grid.grid_line_color = COLOUR["grid"]
    names = [text.get_text() for text in axes.get_yticklabels()]
    if isinstance(axes.yaxis.get_major_locator(), FixedLocator) and names:
        places = [float(place) for place in axes.get_yticks()]
        plot.yaxis[0].ticker = FixedTicker(ticks=places)
        plot.yaxis[0].major_label_overrides = {
            place: _plain(name) for place, name in zip(places, names, strict=False)
        }  # fmt: skip
    for axis in (plot.xaxis, plot.yaxis):
        if not len(axes.get_yticks()) and axis is plot.yaxis:
            axis.visible = False
    _fill(plot, axes, "default")
    hover = HoverTool(tooltips=[("", "$name"), ("x", "$x{0.0000}"), ("y", "$y{0.0000}")], renderers=_lines(plot))
    plot.add_tools(hover)
    return plot


def _plain(text: str) -> Any:
    return PlainText(text=text)


def _style(axis: Any, label: str) -> None:
    axis.axis_label = _plain(label)
    axis.axis_label_text_color = axis.major_label_text_color = COLOUR["ink"]
    axis.axis_line_color = axis.major_tick_line_color = COLOUR["faint"]
    axis.minor_tick_line_color = None
    axis.axis_label_text_font_style = "normal"


def _second(plot: Any, twin: Axes) -> None:
    low, high = twin.get_ylim()
    plot.extra_y_ranges = {**plot.extra_y_ranges, "right": Range1d(start=low, end=high)}
    axis = LinearAxis(y_range_name="right")
    _style(axis, twin.get_ylabel())
    plot.add_layout(axis, "right")
    _fill(plot, twin, "right")
    plot.tools[-1].renderers = _lines(plot)


def _lines(plot: Any) -> list[Any]:
    return [one for one in plot.renderers if one.name]


def _fill(plot: Any, axes: Axes, y_range: str) -> None:
    """Everything drawn in ``axes``, in its order."""
    for artist in sorted(axes.get_children(), key=lambda one: one.get_zorder()):
        if not artist.get_visible():
            continue
        if isinstance(artist, Rectangle) and artist is not axes.patch:
            _rectangle(plot, axes, artist)
        elif isinstance(artist, PolyCollection):
            _band(plot, artist, y_range)
        elif isinstance(artist, LineCollection):
            _bars(plot, artist, y_range)
        elif isinstance(artist, Line2D):
            _line(plot, axes, artist, y_range)
        elif isinstance(artist, Text) and artist.get_text() and artist in axes.texts:
            _text(plot, axes, artist)


def _small(values: Any) -> FloatArray:
    return np.asarray(values, np.float32)


def _rectangle(plot: Any, axes: Any, one: Any) -> None:
    left, width = float(one.get_x()), float(one.get_width())
    look: dict[str, Any] = {"fill_color": to_hex(one.get_facecolor()), "fill_alpha": one.get_alpha() or 1.0}
    if one.get_transform() == axes.get_xaxis_transform() or _blended(one, axes):
        bottom, top = float(one.get_y()), float(one.get_y() + one.get_height())
        if top - bottom < 1.0:  # a strip along the edge
            low, high = axes.get_ylim()
            bottom, top = low + bottom * (high - low), low + top * (high - low)
            _box(plot, left, left + width, bottom, top, look)
        else:
            plot.add_layout(BoxAnnotation(left=left, right=left + width, line_color=None, level="underlay", **look))
        return
    bottom, height = float(one.get_y()), float(one.get_height())
    _box(plot, left, left + width, bottom, bottom + height, look)


def _box(plot: Any, left: float, right: float, bottom: float, top: float, look: dict[str, Any]) -> None:
    source = ColumnDataSource({"left": [left], "right": [right], "bottom": [bottom], "top": [top]})
    plot.add_glyph(source, Quad(line_color=None, **look))


def _blended(one: Any, axes: Axes) -> bool:
    """Whether the vertical place is a fraction of the axes."""
    return axes.transData not in _parts(one.get_transform()) and bool(one.get_transform() != axes.transAxes)


def _parts(transform: Any) -> list[Any]:
    found = [transform]
    for name in ("_a", "_b"):
        if hasattr(transform, name):
            found += _parts(getattr(transform, name))
    return found


def _band(plot: Any, one: Any, y_range: str) -> None:
    colour, alpha = to_hex(one.get_facecolor()[0]), one.get_alpha() or 1.0
    xs, ys = [], []
    for path in one.get_paths():
        corners = path.vertices[np.isfinite(path.vertices).all(axis=1)]
        xs.append(_small(corners[:, 0]))
        ys.append(_small(corners[:, 1]))
    glyph = Patches(fill_color=colour, fill_alpha=alpha, line_color=None)
    plot.add_glyph(ColumnDataSource({"xs": xs, "ys": ys}), glyph, y_range_name=y_range)


def _bars(plot: Any, one: Any, y_range: str) -> None:
    xs, ys = [], []
    for segment in one.get_segments():
        xs.append(_small(segment[:, 0]))
        ys.append(_small(segment[:, 1]))
    glyph = MultiLine(line_color=to_hex(one.get_colors()[0]))
    plot.add_glyph(ColumnDataSource({"xs": xs, "ys": ys}), glyph, y_range_name=y_range)


def _line(plot: Any, axes: Any, one: Any, y_range: str) -> None:
    x, y = (np.asarray(part, np.float64) for part in one.get_data(orig=False))
    colour, label = to_hex(one.get_color()), str(one.get_label())
    dash, width = _DASH.get(one.get_linestyle(), "solid"), 1.3 * float(one.get_linewidth())
    if _blended(one, axes) and len(x) == 2 and one.get_linestyle() != "None":
        across = bool(x[0] != x[1])
        span = Span(location=float(y[0] if across else x[0]), dimension="width" if across else "height",
                    line_color=colour, line_dash=dash, line_width=width)  # fmt: skip
        plot.add_layout(span)
        return
    if _blended(one, axes):
        low, high = axes.get_ylim()
        y = low + y * (high - low)
    if one.get_drawstyle() == "steps-mid" and len(x) > 1:
        edges = np.concatenate([x[:1], 0.5 * (x[1:] + x[:-1]), x[-1:]])
        x, y = np.repeat(edges, 2)[1:-1], np.repeat(y, 2)
    if axes.get_yscale() == "log":
        y = np.where(y > 0.0, y, np.nan)
    source = ColumnDataSource({"x": _small(x), "y": _small(y)})
    name = label if not label.startswith("_") else axes.get_title(loc="left")
    place = {"y_range_name": y_range, "name": name or " "}
    if one.get_linestyle() != "None":
        plot.add_glyph(source, Line(line_color=colour, line_dash=dash, line_width=width), **place)
    if one.get_marker() not in ("None", "", None):
        size = 1.4 * float(one.get_markersize())
        marker = "x" if one.get_marker() == "x" else "circle"
        plot.add_glyph(source, Scatter(size=size, marker=marker, line_color=colour, fill_color=colour), **place)


def _text(plot: Any, axes: Any, one: Any) -> None:
    x, y = (float(value) for value in one.get_position())
    if one.get_transform() == axes.transAxes:
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        x, y = left + x * (right - left), low + y * (high - low)
    align = {"center": "center", "left": "left", "right": "right"}[str(one.get_horizontalalignment())]
    base = {"center": "middle", "top": "top"}.get(str(one.get_verticalalignment()), "bottom")
    source = ColumnDataSource({"x": [x], "y": [y], "text": [one.get_text()]})
    plot.add_glyph(source, Words(text_color=to_hex(one.get_color()), text_font_size="11px", text_align=align,
                                 text_baseline=base))  # fmt: skip


def _legend(plot: Any, axes: Any) -> None:
    """The legend of the drawing; a click on an entry hides its lines."""
    drawn = axes.get_legend()
    if drawn is None:
        return
    items = []
    for text in drawn.get_texts():
        renderers = [one for one in plot.renderers if one.name == text.get_text()]
        if renderers:
            items.append(LegendItem(label=text.get_text(), renderers=renderers))
    if items:
        legend = Legend(items=items, orientation="horizontal", click_policy="hide", border_line_color=None,
                        background_fill_alpha=0.0, label_text_color=COLOUR["ink"], label_text_font_size="11px",
                        ncols="auto")  # fmt: skip
        plot.add_layout(legend, "above")
