"""Takes the pictures of docs/ground.md: the page of a flight in Chromium, on a desktop and a phone, light and dark.

``python -m bench.page_pictures docs/pictures`` flies ``heft hil dymaflex`` and looks at its log as ``heft watch LOG
--page`` shows it; it needs Chromium and Pillow.
"""

import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

from onboard.cli import main
from onboard.page.follow import LogFrames
from onboard.recording.reader import LogReader
from tests.page.browser import browser, opened

SCREENS = {"desktop": (1280, 800), "phone": (390, 844)}
COLOURS = 96  # of a picture: it has few, and is a third as large so
SHOWN_S = 55.0  # of the flight: the payload is held, and all ten of its numbers are good


def take(log: Path, output: Path) -> None:
    """Write ``page_SCREEN_SCHEME.png`` to a directory.

    Args:
        log: of the flight.
        output: is made.
    """
    output.mkdir(parents=True, exist_ok=True)
    source = LogFrames(LogReader(log))
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        browser(Path(profile)) as tab,
        opened(tab, source),
    ):
        tab.wait("document.querySelector('.answer[data-name]') !== null")
        steps = source.about()["steps"]
        number = min(range(len(steps)), key=lambda k: abs(steps[k] - SHOWN_S))
        tab.run(f"(() => {{ const s = document.getElementById('slider'); s.value = {number}; s.oninput(); }})()")
        for name, (width, height) in SCREENS.items():
            for scheme in ("light", "dark"):
                tab.screen(width, height, scheme)
                tab.run("window.scrollTo(0, 0)")
                tab.wait(f"Math.abs(parseFloat(document.getElementById('time').textContent.slice(3)) - {SHOWN_S}) < 1")
                tab.run("new Promise(later => setTimeout(later, 1000)).then(() => 1)")  # the plot is asked for, drawn
                path = output / f"page_{name}_{scheme}.png"
                tab.shot(path)
                with Image.open(io.BytesIO(path.read_bytes())) as shot:
                    few = shot.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
                few.save(path, optimize=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as directory:
        flown = Path(directory) / "dymaflex-001.mcap"
        if main(["hil", "dymaflex", "--log", str(flown)]):
            raise SystemExit(1)
        take(flown, Path(sys.argv[1]))
