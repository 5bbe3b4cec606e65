"""The page's own drawing beside three.js and uPlot: bytes, time to the first paint, CPU of the browser.

    python -m bench.page_drawing [--seconds 10] [--libraries DIR]

Both draw the same four times a second: an arm of 3000 triangles that moves to new positions in between, and ten answers
with 400 points and their intervals each. The page's own files are those of ``onboard/page/static``; the libraries are
fetched by ``npm pack`` in the versions of :data:`LIBRARIES`, or lie unpacked in ``--libraries``; where neither can be
had that is printed, and the page's own numbers alone. Chromium has no GPU here: WebGL is computed (SwiftShader), as the
canvas is.
"""

import argparse
import gzip
import json
import math
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from statistics import median
from typing import Any

from bench.real_flight import cpu_s
from onboard.page.arm import tree_of
from onboard.page.meshes import meshes_of
from onboard.page.web import _static
from tests.page.browser import BROWSER, Tab, browser

LIBRARIES = {"three": "0.187.0", "urdf-loader": "0.13.1", "uplot": "1.6.32"}
NEEDED = (  # of them: what a page loads that shows a URDF with STL and OBJ files, and plots
    "three/build/three.core.js",
    "three/build/three.module.js",
    "three/examples/jsm/controls/OrbitControls.js",
    "three/examples/jsm/loaders/STLLoader.js",
    "three/examples/jsm/loaders/OBJLoader.js",
    "urdf-loader/src/URDFLoader.js",
    "urdf-loader/src/URDFClasses.js",
    "uplot/dist/uPlot.esm.js",
    "uplot/dist/uPlot.min.css",
)
OWN = ("arm.js", "meshes.js", "course.js", "signals.js", "format.js")
LOADS = 7
HERE = Path(__file__).parent / "drawing"
LINK = '<link name="link_{k}"><visual><geometry><cylinder radius="0.05" length="0.3"/></geometry></visual></link>'
JOINT = (
    '<joint name="joint_{k}" type="revolute"><parent link="link_{before}"/><child link="link_{k}"/>'
    '<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/></joint>'
)


def task(place: Path, joints: int = 6) -> None:
    """Write what both pages draw: joints, triangles, courses."""
    links = "".join(LINK.format(k=k) for k in range(joints + 1))
    urdf = f"<robot name='arm'>{links}{''.join(JOINT.format(k=k, before=k - 1) for k in range(1, joints + 1))}</robot>"
    drawn = meshes_of(urdf.encode(), None)
    many = 3000 // sum(len(one) // 9 for one in drawn.corners.values())
    corners = {link: numbers * many for link, numbers in drawn.corners.items()}  # each drawn so often
    times = [120.0 * k / 400 for k in range(400)]
    courses = [
        [(t, math.sin(t / 9 + n), math.sin(t / 9 + n) - 1 / (1 + t), 1 + 1 / (1 + t)) for t in times] for n in range(10)
    ]
    said: dict[str, Any] = {"tree": tree_of({"arm.urdf": urdf.encode()}), "courses": courses}
    (place / "task.json").write_text(json.dumps(said), encoding="utf-8")
    (place / "meshes").write_text(json.dumps(drawn._replace(corners=corners)._asdict()), encoding="utf-8")


def fetched(place: Path) -> str:
    """Unpack the libraries there; why that is not possible, or empty."""
    for name, version in LIBRARIES.items():
        command = ["npm", "pack", "--silent", f"{name}@{version}"]
        try:
            ran = subprocess.run(command, cwd=place, capture_output=True, text=True, check=True, timeout=120)
        except (OSError, subprocess.SubprocessError) as error:
            return f"{' '.join(command)}: {error}"
        with tarfile.open(place / ran.stdout.split()[-1]) as archive:
            archive.extractall(place / f"{name}.unpacked", filter="data")
        (place / f"{name}.unpacked" / "package").rename(place / name)
    return ""


def size_line(label: str, contents: list[bytes]) -> str:
    """Bytes of files as they are, and compressed by gzip."""
    packed = sum(len(gzip.compress(one, 9)) for one in contents)
    return f"{label}: {sum(map(len, contents)) / 1000:.0f} kB, gzip {packed / 1000:.0f} kB"


def below(pid: int) -> list[int]:
    """All processes that a process has started, directly or not."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            found += [child, *below(child)]
    return found


def used(tab: Tab, url: str, seconds: float) -> tuple[float, float, float]:
    """First paint [ms], CPU of the browser [% of a core], frames of the arm a second."""
    painted = []
    for _ in range(LOADS):
        tab.open(url)
        painted.append(float(tab.wait("window.painted_ms")))
    before, began_s, frames = sum(map(cpu_s, below(os.getpid()))), time.monotonic(), int(tab.run("frames_drawn"))
    time.sleep(seconds)
    spent, passed_s = sum(map(cpu_s, below(os.getpid()))) - before, time.monotonic() - began_s
    errors = [one for one in tab.said if one.get("entry", {}).get("level") != "warning"]  # WebGL warns of its speed
    assert not errors, errors
    return median(painted), 100.0 * spent / passed_s, (int(tab.run("frames_drawn")) - frames) / passed_s


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Nothing."""


def main() -> int:
    """Print the sizes, then what drawing takes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--libraries", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory, tempfile.TemporaryDirectory() as profile:
        place = Path(directory)
        (place / "static").mkdir()
        for name, content in (static := _static()).items():
            (place / "static" / name).write_bytes(content)
        for path in HERE.iterdir():
            shutil.copy(path, place)
        task(place)
        if options.libraries:
            missing = next(
                (f"{options.libraries} has no {one}" for one in NEEDED if not (options.libraries / one).is_file()), ""
            )
            for name in LIBRARIES if not missing else ():
                shutil.copytree(options.libraries / name, place / name)
        else:
            missing = fetched(place)
        print(size_line(f"own drawing ({', '.join(OWN)})", [static[name] for name in OWN]))
        if missing:
            print(f"three.js and uPlot are not measured: {missing}")
        else:
            versions = ", ".join(f"{name} {version}" for name, version in LIBRARIES.items())
            print(size_line(versions, [(place / one).read_bytes() for one in NEEDED]))
        if BROWSER is None:
            print("there is no Chromium: nothing is drawn")
            return 0
        with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=directory)) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            with browser(Path(profile), "--enable-unsafe-swiftshader") as tab:
                tab.screen(1280, 800)
                for name in ("own", *(() if missing else ("libraries",))):
                    url = f"http://127.0.0.1:{server.server_port}/{name}.html"
                    paint_ms, cpu, frames = used(tab, url, options.seconds)
                    print(
                        f"{name}: first paint {paint_ms:.0f} ms, {cpu:.0f} % of a core, "
                        f"{frames:.0f} pictures of the arm a second"
                    )
            server.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
