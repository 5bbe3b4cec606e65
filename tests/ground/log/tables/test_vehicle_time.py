"""Vehicle time of a log's samples, where the host was late at the start."""

from pathlib import Path

import numpy as np

from onboard import cli, config
from onboard.ground.log.tables.flight_tables import FlightTables
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

SCENARIO = 'sequence = [{phase = 0, action = "hold", duration_s = 1.2}]\n'
LATE_NS = 6_000_000


def test_samples_that_a_busy_host_read_late_at_first_have_their_own_times(tmp_path: Path) -> None:
    """Timed by arrival until the marks give a clock, they were 3.6 ms late, and the first by the marks stepped back."""
    over, log, late = tmp_path / "over.toml", tmp_path / "log.mcap", tmp_path / "late.mcap"
    over.write_text(SCENARIO)
    cli.main(["hil", "rocksat", "--scenario", str(over), "--seed", "3", "--log", str(log)])
    reader = LogReader(log)
    with LogWriter.create(late, durable=False) as writer:
        for name, dtype in reader.channels.items():
            rows = reader.read(name).copy()
            if name == "imu_base":
                host_ns = rows["host_ns"]
                host_ns[host_ns < host_ns[0] + 130_000_000] += LATE_NS
                rows["host_ns"] = np.maximum.accumulate(host_ns)
            writer.register(name, dtype)
            writer.write(name, rows)
    vehicle = config.load(config.packaged("rocksat"))
    times_ns, late_ns = (FlightTables(path, vehicle).read("imu_base")["time_ns"] for path in (log, late))
    assert len(times_ns) > 900
    assert (np.diff(times_ns) > 0).all()
    assert (late_ns == times_ns).all()
