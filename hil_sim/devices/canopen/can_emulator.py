"""What the tables of all CANopen nodes have, ``[device.NAME]``."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Protocol

from pydantic import Field

from hil_sim.devices.emulator import MeasuringEmulator, Twin


class CountingNode(Protocol):
    """A node that counts its samples."""

    @property
    def produced(self) -> int:
        """Samples made so far."""

    def guard_for_heartbeat(self) -> None:
        """Make no heartbeat, but answer node guarding."""


class CanNodeEmulator(MeasuringEmulator):
    """A CANopen node."""

    needs = "can"
    has_clock = False
    where = "node {node}"

    node: Annotated[int, Field(ge=1, le=127)]
    supervision: Literal["heartbeat", "guarding"] = "heartbeat"

    @staticmethod
    def node_keys(said: Mapping[str, Any]) -> dict[str, Any]:
        """Keys that a node's table in a vehicle file has too."""
        return {key: said[key] for key in ("node", "supervision") if key in said}

    def supervised(self, node: CountingNode, *channels: str) -> Twin:
        """The node, watched as the table says; ``channels``: what the flight computer records of it."""
        if self.supervision == "guarding":
            node.guard_for_heartbeat()
        return Twin(node, lambda: node.produced, channels)
