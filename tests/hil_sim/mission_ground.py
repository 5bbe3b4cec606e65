"""A short mission on its buses, heard by a flight computer written here with smbus2 and python-can alone."""

import re
import socket
import struct

import can
import smbus2

from hil_sim.mission import open_in_process

SHORT = {
    "sequence": [
        {"phase": 0, "action": "hold", "duration_s": 0.5},
        {
            "phase": 4,
            "action": "strokes",
            "amplitude": {"joint_1": 0.2007},
            "stroke_s": 0.6,
            "strokes": 1,
            "pause_s": 0.0,
            "transfer_s": 0.6,
        },
        {"phase": 5, "action": "hold", "duration_s": 0.3},
        {"phase": 9, "action": "hold", "duration_s": 0.2},
    ],
    "sensor": {"load_cell": {"full_scale_readings_s": [1.203, 1.607]}},
}
START_NMT = bytes([0x01, 0x00])


class Ground:
    """Flies a mission and keeps what the buses said."""

    def __init__(self, scenario, seed: int = 5, step_ns: int = 10_000_000, wake_imu: bool = False) -> None:
        self.mission, urls = open_in_process(scenario, seed)
        mission = self.mission
        self.frames: list[tuple[int, int, bytes]] = []
        self.edges: list[tuple[int, int]] = []
        channel = re.fullmatch(r"can\+virtual://([^?]+)\?timestamps=monotonic", urls["can_0"]).group(1)
        pulse_path = urls["sync_line"].removeprefix("gpio+unix://")
        with (
            mission,
            can.Bus(interface="virtual", channel=channel, preserve_timestamps=True) as bus,
            socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as pulses,
            smbus2.SMBus(urls["i2c_1"].removeprefix("i2c://")) as i2c,
        ):
            pulses.bind(pulse_path)
            pulses.setblocking(False)
            mission.advance(mission.start_ns + 100_000_000)
            if wake_imu:
                for register, value in (
                    (0x6B, 1),
                    (0x19, 0),
                    (0x1A, 2),
                    (0x1B, 0),
                    (0x1C, 8),
                    (0x23, 0xF8),
                    (0x6A, 0x40),
                ):
                    i2c.write_byte_data(0x68, register, value)
            bus.send(can.Message(arbitration_id=0x000, data=START_NMT, is_extended_id=False))
            self.words: list[tuple[int, tuple[int, ...]]] = []
            while not mission.finished:
                mission.advance(min(mission.now_ns + step_ns, mission.end_ns))
                while (message := bus.recv(0)) is not None:
                    self.frames.append((round(message.timestamp * 1e9), message.arbitration_id, bytes(message.data)))
                self._drain(pulses)
                if wake_imu:
                    burst = bytes(i2c.read_i2c_block_data(0x68, 0x3B, 14))
                    self.words.append((mission.now_ns, struct.unpack(">7h", burst)))
            self.produced = mission.produced()
            self.truth = mission.truth()

    def _drain(self, pulses: socket.socket) -> None:
        while True:
            try:
                self.edges.append(struct.unpack("<qI", pulses.recv(64)))
            except BlockingIOError:
                return

    def of(self, cob_id: int) -> list[tuple[int, bytes]]:
        return [(stamp, data) for stamp, identifier, data in self.frames if identifier == cob_id]

    def seconds(self, stamp_ns: int) -> float:
        return 1e-9 * (stamp_ns - self.mission.start_ns)
