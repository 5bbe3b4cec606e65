"""A proposed mapping as TOML, with what is doubtful in comments."""

import json
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from onboard.ground.log.bring_in.guess.magnitudes import FloatArray, Unit, count_of
from onboard.ground.log.bring_in.mapping import Csv

_INT16 = 8000.0  # a quarter: other recordings by the same mapping may go further
_MOST_NAMED = 80


def quoted(text: str) -> str:
    """A TOML string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


class Key(NamedTuple):
    """A line, and what is to be said of it."""

    text: str
    doubt: str = ""
    why: str = ""

    @property
    def lines(self) -> str:
        """With its comments."""
        before = f"# doubtful: {self.doubt}\n" if self.doubt else ""
        return f"{before}{self.text}{f'    # {self.why}' if self.why else ''}\n"


def head(name: str, file: str, kind: str, bad_rows: str, layout: Csv | None, said: Sequence[str]) -> str:
    """All before the channels but the clock."""
    text = f"# Proposed by heft import --guess {json.dumps(file)}.\n"
    text += "# Look at it, then: heft import MAPPING RECORDING -o logs\n"
    text += "".join(f"# {one}\n" for one in said)
    text += f"\n[mapping]\nname = {quoted(name)}\nformat = {quoted(kind)}\n"
    if bad_rows:
        text += f'bad_rows = "skip"    # {bad_rows}\n'
    if layout is not None and (keys := layout.model_dump(exclude_defaults=True)):
        text += "\n[csv]\n" + "".join(
            f"{key} = {quoted(value) if isinstance(value, str) else json.dumps(value)}\n" for key, value in keys.items()
        )
    return text


def vector(table: str, columns: Sequence[str], values: FloatArray, unit: Unit) -> str:
    """A table of three columns of an IMU, whose counts have 16 bits."""
    keys = [Key(f"columns = [{', '.join(map(quoted, columns))}]")]
    if unit.counts != 1.0 and bool((values == np.rint(values)).all()):
        keys.append(Key(f"scale = [1, {unit.counts:g}]", why="whole counts"))
    else:
        largest = float(np.nanmax(np.abs(values), initial=0.0)) / unit.counts
        digits = next((d for d in (1, 2, 5) if d >= _mantissa(largest / _INT16)), 10)
        scale = digits * 10.0 ** _exponent(largest / _INT16)
        keys += [Key('values = "physical"'), Key(f"scale = {float(f'{scale:.3g}')!r}", why="16 bits hold it all")]
    keys.append(Key(f"unit = {quoted(unit.name)}", unit.doubt, unit.why))
    return f"\n[{table}]\n" + "".join(key.lines for key in keys)


def _exponent(value: float) -> int:
    return int(np.floor(np.log10(value))) if value > 0.0 else -6


def _mantissa(value: float) -> float:
    return value / 10.0 ** _exponent(value) if value > 0.0 else 1.0


def scalar(
    name: str,
    column: str,
    values: FloatArray,
    unit: Unit,
    time: str,
    doubt: str = "",
    turn: float = 0.0,
    sign: str = "+",
) -> str:
    """A channel of one value, which starts again after ``turn``; 0: it does not."""
    keys = [Key(f"column = {quoted(column)}", doubt)]
    keys += [Key(f"sign = {quoted(sign)}")] if sign == "-" else []
    keys += [Key(f"wraps = {turn!r}", why="it starts again after a turn")] if turn else []
    if unit.counts != 1.0:
        keys.append(Key(f"scale = [1, {unit.counts:g}]", why="whole counts"))
    else:
        keys += [Key('values = "physical"'), Key(f"scale = {count_of(values)!r}")]
    keys.append(Key(f"unit = {quoted(unit.name)}", unit.doubt, unit.why))
    text = f'\n[channel.{name}]\nrecord = "scalar"\n{time}\n[channel.{name}.value]\n'
    return text + "".join(key.lines for key in keys)


def yaw(name: str, quaternion: Sequence[str], up: str, time: str) -> str:
    """A channel of the yaw of a quaternion, w first."""
    keys = [Key(f"quaternion = [{', '.join(map(quoted, quaternion))}]")]
    keys += [Key(f"up = {quoted(up)}", why="it turns about this axis most")] if up != "z" else []
    keys += [Key('values = "physical"'), Key("scale = 1e-08"), Key('unit = "rad"')]
    return f'\n[channel.{name}]\nrecord = "scalar"\n{time}\n[channel.{name}.value]\n' + "".join(
        key.lines for key in keys
    )


def not_taken(columns: Sequence[tuple[str, str]]) -> str:
    """Columns that are not read, and why; by reason."""
    text = ""
    for why in dict.fromkeys(why for _, why in columns):
        some = [json.dumps(name, ensure_ascii=False) for name, own in columns if own == why]
        more = f" and {len(some) - _MOST_NAMED} more" if len(some) > _MOST_NAMED else ""
        text += f"# not taken ({why}): {', '.join(some[:_MOST_NAMED])}{more}\n"
    return f"\n{text}" if text else ""
