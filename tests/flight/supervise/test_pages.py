"""What is given back of a process's program files; tried in a process of its own."""

import subprocess
import sys

from onboard.flight.supervise import pages

SMAPS = """\
7f00-7f10 r-xp 00000000 fe:00 12 /lib/of_code.so
Rss:                  64 kB
Anonymous:             0 kB
7f10-7f20 r--p 00000000 fe:00 12 /lib/of_code.so
Rss:                  64 kB
Anonymous:             4 kB
7f20-7f30 rw-p 00000000 fe:00 12 /lib/of_code.so
Rss:                  64 kB
Anonymous:             0 kB
7f30-7f40 r--s 00000000 00:1b 99 /dev/shm/heft/row.ring
Rss:                  64 kB
Anonymous:             0 kB
7f40-7f50 r-xp 00000000 00:00 0 [vdso]
Rss:                   4 kB
Anonymous:             0 kB
7f50-7f60 r--p 00000000 fe:00 13 /lib/not_touched.so
Rss:                   0 kB
Anonymous:             0 kB
"""

LOADED = """
import resource
import numpy.random
import scipy.linalg
from onboard.flight.supervise import pages

def resident_kb():
    lines = open("/proc/self/smaps_rollup", encoding="ascii").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Rss:"))

before = resident_kb()
given = pages.give_back()
after = resident_kb()
x = scipy.linalg.cho_solve(scipy.linalg.cho_factor(numpy.diag([4.0, 9.0])), numpy.ones(2))
print(given // 1024, before - after, *x, numpy.random.Generator(numpy.random.PCG64(1)).integers(10))
"""


def test_only_what_is_unchanged_of_a_file_and_read_only_is_given_back():
    assert list(pages.unchanged(SMAPS)) == [(0x7F00, 0x7F10, 65536)]


def test_a_process_goes_on_without_the_pages_that_it_gave_back():
    ran = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True, timeout=60)
    given_kb, less_kb, first, second, drawn = map(float, ran.stdout.split())
    assert given_kb > 5_000
    assert less_kb > 0.7 * given_kb
    assert (first, second, drawn) == (0.25, 1 / 9, 4)
