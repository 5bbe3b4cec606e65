"""A flight whose log is written in segments of half a second."""

from onboard.recording.format.mcap_format import Attachment
from onboard.recording.segmented import Preamble, SegmentedLog, SegmentLimits
from tests.recording.logs import LABEL, READING, label_rows, reading_rows

STEP_NS = 50_000_000
PREAMBLE = Preamble(
    "f1",
    (Attachment("vehicle.toml", "application/toml", b'name = "x"\n', 0),),
    {"flight": {"vehicle": "x"}, "versions": {"heft": "1"}},
)


class Flight:
    """Writes 40 rows a step of 50 ms; a segment lasts 10 steps."""

    def __init__(self, log, preamble=PREAMBLE, **options):
        self.writer = SegmentedLog.resume(log, preamble, limits=SegmentLimits(span_ns=10 * STEP_NS), **options)
        self.writer.register("reading", READING)
        self.writer.register("label", LABEL)
        self.now_ns = self.number = 0

    def steps(self, count):
        for _ in range(count):
            self.writer.write("reading", reading_rows(self.number, 40))
            self.writer.write("label", label_rows(self.number, 40))
            self.number += 40
            self.writer.sync(self.now_ns)
            self.now_ns += STEP_NS
