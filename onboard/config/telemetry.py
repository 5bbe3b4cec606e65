"""``[telemetry]``: the packets that ``heft fly --telemetry`` sends down, how often, and how many bytes a second."""

from typing import Annotated, Literal

from pydantic import Field

from onboard.section import Section

Apid = Annotated[int, Field(ge=0, le=2039)]  # those from 2040 on are reserved (CCSDS 135.0-B)
Rate = Annotated[float, Field(ge=0.001, le=10)]


class Telemetry(Section):
    """Downlink of a flight; see docs/ground.md.

    ``bytes_s``: what all packets together may take. ``..._hz``: how often a packet of the kind is due, of answers and
    reasons one of each quantity. ``..._apid``: application process identifiers, each kind of packet another.
    ``commands``: what may be asked of the flight, over the link that it sends by and on its page; nothing else may.
    """

    bytes_s: Annotated[float, Field(ge=100, le=1e7)] = 1200.0
    status_hz: Rate = 1.0
    answers_hz: Rate = 0.5
    phase_hz: Rate = 0.2
    flight_hz: Rate = 0.1
    reasons_hz: Rate = 0.02
    status_apid: Apid = 256
    answer_apid: Apid = 257
    phase_apid: Apid = 258
    event_apid: Apid = 259
    reason_apid: Apid = 260
    flight_apid: Apid = 261
    report_apid: Apid = 262
    failure_apid: Apid = 263
    command_apid: Apid = 264
    commands: list[Literal["mark", "stop", "span"]] = Field(default_factory=list)

    @property
    def apids(self) -> dict[str, int]:
        """APIDs by kind of packet that is sent."""
        kinds = (key.removesuffix("_apid") for key in type(self).model_fields if key.endswith("_apid"))
        return {kind: getattr(self, f"{kind}_apid") for kind in kinds if kind != "command"}
