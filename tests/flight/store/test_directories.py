"""Directories in shared memory: whose they are, what is refused, what is left of them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from onboard import cli, config
from onboard.cli.common import next_log
from onboard.flight.store import directories, manifest
from onboard.flight.store.directories import NotPrivateError
from onboard.flight.supervise.resume import write_durably


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HEFT_RINGS", str(tmp_path / "rings"))
    return tmp_path / "rings"


def test_what_is_made_is_for_this_user_alone(place: Path) -> None:
    with directories.made("log", "1") as directory:
        directories.write_private(directory / "file", b"x")
        assert {path.stat().st_mode & 0o777 for path in (place, directory)} == {0o700}
        assert {path.stat().st_mode & 0o777 for path in directory.iterdir()} == {0o600}
        assert not directories.is_free(directory)
    assert directories.is_free(directory)


@pytest.mark.parametrize("mode", [0o755, 0o701, 0o770, 0o777])
def test_a_place_that_others_may_enter_is_refused(place: Path, mode: int) -> None:
    place.mkdir()
    place.chmod(mode)
    with pytest.raises(NotPrivateError, match="chmod 700"), directories.made("log", "1"):
        pytest.fail("it was used")
    assert list(place.iterdir()) == []


def test_no_flight_begins_in_a_place_that_others_may_enter(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place.mkdir(mode=0o755)
    assert cli.main(["fly", str(config.packaged("rocksat")), "--log", str(place.parent / "a.mcap")]) == cli.BAD_INPUT
    assert "other users may enter" in capsys.readouterr().err


def test_a_place_of_another_user_is_refused(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place.mkdir(mode=0o700)
    monkeypatch.setattr(os, "getuid", lambda: place.stat().st_uid + 1)
    for use in (lambda: directories.made("log", "1").__enter__(), manifest.running, lambda: directories.sweep("x")):
        with pytest.raises(NotPrivateError, match="belongs to user"):
            use()


def test_a_link_is_not_followed(place: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    place.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(NotPrivateError, match="not a directory"), directories.made("log", "1"):
        pytest.fail("it was used")


def test_what_a_start_left_that_was_cut_off_before_its_manifest_is_swept(place: Path) -> None:
    with directories.made("dead", "1") as dead:
        (dead / "imu.ring").write_bytes(b"x")
    with directories.made("dead", "2") as manifested:
        (manifested / "manifest.json").write_text("{}")
    with directories.made("living", "3") as living:
        with manifest.abandoned() as found:
            assert found == [manifested]
        assert {path.name for path in place.iterdir()} == {manifested.name, living.name}


_SCRATCH = """
import os, signal
from onboard.flight.store.directories import scratch
with scratch() as directory:
    (directory / "imu.ring").write_bytes(b"x")
    print(directory, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_run_in_the_simulator_leaves_nothing_beyond_the_next_start() -> None:
    left = subprocess.run([sys.executable, "-c", _SCRATCH], capture_output=True, text=True, check=False)
    directory = Path(left.stdout.strip())
    assert (directory / "imu.ring").exists()
    with directories.scratch() as mine:
        assert not directory.exists()
        with directories.scratch():
            assert mine.exists()  # a run beside this one takes nothing from it
    assert not mine.exists()


def test_a_long_name_of_a_log_makes_a_directory_too() -> None:
    with directories.made("x" * 250, "1") as directory:
        assert directory.is_dir()


@pytest.mark.timeout(20)
@pytest.mark.parametrize("what", ["pipe", "directory", "link", "readable"])
def test_a_private_file_is_written_into_nothing_else(tmp_path: Path, what: str) -> None:
    path, elsewhere = tmp_path / "a.resume", tmp_path / "elsewhere"
    elsewhere.write_bytes(b"mine")
    place = tmp_path / "a.resume.new"
    if what == "pipe":
        os.mkfifo(place, 0o600)
    elif what == "directory":
        place.mkdir()
    elif what == "link":
        place.symlink_to(elsewhere)
    else:
        place.write_bytes(b"mine")
        place.chmod(0o644)
    with pytest.raises(OSError, match=r"no file, but|this user's alone"):
        write_durably(path, b"x")
    assert elsewhere.read_bytes() == b"mine"
    assert what != "readable" or place.read_bytes() == b"mine"
    assert not path.exists()


def test_a_link_to_nothing_takes_a_logs_name(tmp_path: Path) -> None:
    (tmp_path / "x-001.mcap").symlink_to("/nowhere")
    assert next_log(str(tmp_path), "x") == tmp_path / "x-002.mcap"


def test_a_flight_whose_first_segments_were_removed_keeps_its_name(tmp_path: Path) -> None:
    (tmp_path / "x-001_007.mcap").touch()
    (tmp_path / "y-001_007.mcap").touch()
    assert next_log(str(tmp_path), "x") == tmp_path / "x-002.mcap"
