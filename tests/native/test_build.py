"""How the library is made: by every compiler the same bits, without one an error; and that it keeps to its arrays."""

import importlib.util
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from onboard.native import build, library
from onboard.native.errors import NativeError
from tests.native.calls import outcomes

ROOT = Path(__file__).resolve().parents[2]
CODE_LINES, ALL_LINES = 300, 3500
UNOPTIMISED = tuple("-O0" if flag == "-O3" else flag for flag in build.FLAGS)
IMPORT = "from onboard.native import library; print(library.LIBRARY._name)"


def python(*arguments, checkout=ROOT, **environment):
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout), **environment},
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
    )


@pytest.fixture(scope="module")
def ours():
    return [outcomes(seed) for seed in range(12)]


@pytest.mark.parametrize(
    ("compiler", "flags"),
    [
        pytest.param(
            "gcc", build.FLAGS, id="gcc-O3", marks=pytest.mark.campaign
        ),  # ours is made so, where gcc is there
        pytest.param("gcc", UNOPTIMISED, id="gcc-O0"),
        pytest.param("clang", build.FLAGS, id="clang-O3"),
        pytest.param("clang", UNOPTIMISED, id="clang-O0", marks=pytest.mark.campaign),
        pytest.param("zig", build.FLAGS, id="zig-O3"),
        pytest.param("zig", UNOPTIMISED, id="zig-O0", marks=pytest.mark.campaign),
    ],
)
def test_every_compiler_makes_the_same_bits(compiler, flags, ours, tmp_path, monkeypatch):
    commands = {Path(command[0]).name: command for command in build.system_compilers()}
    for command in build.compilers():
        commands |= {"zig": command} if "ziglang" in command else {}
    if compiler not in commands:
        pytest.skip(f"no {compiler} here")
    path = tmp_path / build.file_name()
    build.compile_into(path, commands[compiler], flags)
    monkeypatch.setattr(library, "LIBRARY", library.open_library(path))
    for seed, before in enumerate(ours):
        after = outcomes(seed)
        assert len(after) == len(before) > 30
        for k, (one, other) in enumerate(zip(before, after, strict=True)):
            assert (
                memoryview(one).tobytes() == memoryview(other).tobytes() if hasattr(one, "shape") else one == other
            ), k


@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="no zig here")
@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_a_wheels_library_is_the_same_wherever_the_sources_lie(machine, tmp_path, monkeypatch):
    made = []
    for place in ("here", "there"):
        sources = shutil.copytree(build.SOURCES, tmp_path / place / "src")
        monkeypatch.setattr(build, "SOURCES", sources)
        path = tmp_path / place / build.file_name(machine)
        build.compile_into(path, build.zig(machine))
        made.append(path.read_bytes())
    assert made[0] == made[1]


def test_nothing_is_read_or_written_out_of_bounds(tmp_path):
    """Address and undefined-behaviour sanitizers, with random and with wrong arguments."""
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("no gcc here")
    path, checks = tmp_path / build.file_name(), "address,undefined,float-cast-overflow"
    flags = *UNOPTIMISED, "-g", f"-fsanitize={checks}", "-fno-sanitize-recover=all"  # -O3: 24 s of compiling
    build.compile_into(path, [gcc], flags)
    names = "libasan.so", "libstdc++.so"  # the second, for the first looks for what Pinocchio throws errors with
    asked = [[gcc, f"-print-file-name={name}"] for name in names]
    found = [subprocess.run(one, capture_output=True, text=True, check=True).stdout.strip() for one in asked]
    done = python(
        *("-m", "tests.native.calls", str(path), "1"),
        LD_PRELOAD=" ".join(os.path.realpath(one) for one in found),
        ASAN_OPTIONS="detect_leaks=0",
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stderr[-3000:]
    assert int(done.stdout.split()[0]) >= 40


def test_the_sources_are_few_and_short():
    lines = {path.name: len(path.read_text().splitlines()) for path in build.SOURCES.iterdir()}
    assert max(lines.values()) <= CODE_LINES
    assert 500 < sum(lines.values()) <= ALL_LINES


def test_only_one_compiler_is_needed_and_the_next_is_taken_where_one_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(build.compile_into, "__defaults__", (UNOPTIMISED,))
    monkeypatch.setattr(build, "compilers", lambda: [["/nowhere/cc"], ["false"], build.system_compilers()[0]])
    assert build.build(tmp_path).name == build.file_name()
    assert [one.name for one in tmp_path.iterdir()] == [build.file_name()]


@pytest.fixture
def bare_checkout(tmp_path):
    """A checkout without a library beside its sources; it makes one in a quarter of the time."""
    root = tmp_path / "checkout"
    shutil.copytree(ROOT / "onboard", root / "onboard", ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    shutil.copytree(ROOT / "drivers", root / "drivers", ignore=shutil.ignore_patterns("__pycache__"))
    module = root / "onboard/native/build.py"
    module.write_text(module.read_text().replace('"-O3"', '"-O0"'))
    return root


def test_several_processes_that_make_it_at_once_all_find_it_whole(bare_checkout, tmp_path):
    cache = tmp_path / "cache"
    with ThreadPoolExecutor(2) as pool:
        each = [pool.submit(python, "-c", IMPORT, checkout=bare_checkout, XDG_CACHE_HOME=str(cache)) for _ in range(2)]
    done = [one.result() for one in each]
    assert [one.returncode for one in done] == [0] * 2, done[0].stderr
    [made] = (cache / "heft").iterdir()
    assert {one.stdout.strip() for one in done} == {str(made)}


def test_without_any_compiler_a_command_ends_with_the_remedy(bare_checkout, tmp_path):
    blocked = tmp_path / "sitecustomize.py"
    blocked.write_text("import sys\nsys.modules['ziglang'] = None\n")
    path = f"{bare_checkout}:{tmp_path}"
    for cache in ("cache", "."):
        done = subprocess.run(
            [sys.executable, "-m", "onboard.cli", "hil", "rocksat"],
            cwd=tmp_path,
            env={"PATH": "/nowhere", "PYTHONPATH": path, "XDG_CACHE_HOME": str(tmp_path / cache)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 69, done.stderr
        assert "sudo apt install gcc" in done.stderr
        assert "Traceback" not in done.stderr


def test_a_library_of_other_sources_is_refused(tmp_path, monkeypatch):
    path = shutil.copy(Path(os.environ["XDG_CACHE_HOME"]) / "heft" / build.file_name(), tmp_path)
    monkeypatch.setattr(build, "key", lambda: "0123456789abcdef")
    with pytest.raises(NativeError, match="of other sources"):
        library.open_library(path)
    torn = tmp_path / "torn.so"
    torn.write_bytes(b"no library")
    with pytest.raises(NativeError, match="cannot be loaded"):
        library.open_library(torn)


def test_a_cache_that_others_can_write_is_not_used(bare_checkout, tmp_path):
    shared = tmp_path / "shared"
    (shared / "heft").mkdir(parents=True)
    (shared / "heft").chmod(0o777)
    home = str(tmp_path / "home")
    done = python("-c", IMPORT, checkout=bare_checkout, XDG_CACHE_HOME=str(shared), HOME=home)
    assert done.returncode == 0, done.stderr
    [made] = (tmp_path / "home/.cache/heft").iterdir()
    assert done.stdout.strip() == str(made)
    assert list((shared / "heft").iterdir()) == []
