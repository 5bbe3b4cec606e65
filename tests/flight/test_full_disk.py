"""A disk that refuses in a rehearsal: the answer is printed all the same; the reason names file, size and remedy."""

import resource
import subprocess
import sys
import time
from pathlib import Path

import pytest

from onboard import cli
from onboard.recording.reader import LogReader
from onboard.recording.space import refusal
from tests.flight.missions import SHORTER, inline

LIMIT = 300_000  # bytes of a file


@pytest.mark.usefixtures("own_rings")
@pytest.mark.timeout(300)
def test_the_answer_of_a_flight_whose_log_may_not_grow_is_printed(tmp_path: Path) -> None:
    log, short, result = tmp_path / "flown.mcap", tmp_path / "short.toml", tmp_path / "flown.json"
    short.write_text(f"sequence = [{', '.join(map(inline, SHORTER))}]\n")
    command = [sys.executable, "-m", "onboard.cli", "hil", "rocksat", "--scenario", str(short), "--log", str(log)]
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, "--json", str(result)], stdout=pipe, stderr=pipe, text=True) as flight:
        while flight.poll() is None and not (log.exists() and log.stat().st_size > 100_000):
            time.sleep(0.01)
        hard = resource.prlimit(flight.pid, resource.RLIMIT_FSIZE)[1]
        resource.prlimit(flight.pid, resource.RLIMIT_FSIZE, (LIMIT, hard))
        out, err = flight.communicate()
    assert flight.returncode == cli.FAILED, err  # rows are missing
    assert log.stat().st_size == LIMIT
    for answer in ("m4 (arm), g", "m5 (tip mass), g"):
        [row] = [line for line in out.splitlines() if line.strip().startswith(answer)]
        assert ".." in row  # an interval
    told = " ".join(out.split())
    assert f"flown.mcap: {LIMIT} bytes, then file too large: a file may have {LIMIT} bytes here; raise it" in told
    assert "in no gap record" in told
    assert "Traceback" not in err
    assert len(LogReader(log).read("imu_base")) > 100


def test_every_refusal_names_file_size_and_remedy(tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    file.write_bytes(bytes(1234))
    for number, remedy in ((28, "remove what is not needed"), (27, "ulimit -f"), (122, "the quota of user")):
        text = refusal(OSError(number, "refused", str(file)))
        assert text.startswith(f"{file}: 1234 bytes, then refused: ")
        assert remedy in text
        assert refusal(OSError(number, "refused", str(file)), short=True).startswith("a.mcap: 1234 bytes")
    assert refusal(OSError(5, "Input/output error", "/nowhere")) == "/nowhere: input/output error"


def test_segments_stay_below_what_a_file_may_have(tmp_path: Path) -> None:
    program = f"""
import resource
from pathlib import Path
from onboard.recording.segmented import Preamble, SegmentedLog
from tests.recording.logs import READING, reading_rows
writer = SegmentedLog(Path({str(tmp_path / "a.mcap")!r}), Preamble("f1"), sync_interval_ns=0)
writer.register("reading", READING)
for n in range(100):
    if n == 20:
        resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))
    writer.write("reading", reading_rows(200 * n, 200))
    writer.sync(n)
writer.close()
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=Path(__file__).parents[2])
    log = LogReader(tmp_path / "a.mcap")
    assert log.complete
    assert len(log.segments) > 2
    assert log.read("reading")["sequence"].tolist() == list(range(20_000))
