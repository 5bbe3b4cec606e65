"""The C of docs/sync_pulse.md makes the pulses that the flight computer names."""

import re
import subprocess
from pathlib import Path

import numpy as np

from drivers.sync_pulse import code

PAGE = Path(__file__).parents[2] / "docs" / "sync_pulse.md"
MAIN = r"""
#include <stdio.h>
static int counter = 1, syncs, dither_us_100;
static int sent, pulses;
static void send_sync(int number) { sent = number; syncs++; }
static void raise_line_after_us(double us)
{
    dither_us_100 = (int)(us * 100.0 + 0.5);
    if (sent != (syncs - 1) % 240 + 1) printf("counter %d\n", sent);
    printf("%d %d\n", syncs - 1, dither_us_100);
    pulses++;
}
"""
START = r"""
int main(void)
{
    code_start(); code_next(); to_go = 0; n = 0; counter = 1;
    while (pulses < 2 * 32768) every_sync_period();
    return 0;
}
"""


def test_the_c_of_the_page_makes_the_published_code(tmp_path: Path) -> None:
    blocks = re.findall(r"```c\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 2
    source, program = tmp_path / "pulses.c", tmp_path / "pulses"
    source.write_text(MAIN + "".join(blocks) + START, encoding="utf-8")
    subprocess.run(["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-o", program, source], check=True)
    out = subprocess.run([program], check=True, capture_output=True, text=True).stdout
    made = np.array([line.split() for line in out.splitlines()], np.int64)
    cycles = np.arange(2)[:, None]
    assert made[:, 0].tolist() == (code.sync_numbers() + cycles * code.cycle_sync_periods()).reshape(-1).tolist()
    assert made[:, 1].tolist() == np.tile(code.dither_ns() // 10, 2).tolist()
