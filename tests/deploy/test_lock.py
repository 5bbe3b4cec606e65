"""The lock files: everything pinned and hashed, nothing of the machine that made them, in step with pyproject.toml."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from onboard.native.build import ZIG

ROOT = Path(__file__).resolve().parents[2]
LOCKS = ("requirements.lock", "requirements-test.lock")


def pins(name: str) -> dict[str, Requirement]:
    """Requirement by canonical package name."""
    text = (ROOT / "deploy" / name).read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    requirements = [Requirement(line.split(" --hash=")[0]) for line in lines]
    return {canonicalize_name(requirement.name): requirement for requirement in requirements}


def version(pin: Requirement) -> str:
    (specifier,) = pin.specifier
    assert specifier.operator == "=="
    return specifier.version


@pytest.mark.parametrize("name", LOCKS)
def test_every_line_is_a_pin_a_hash_or_a_comment(name: str) -> None:
    lines = (ROOT / "deploy" / name).read_text(encoding="utf-8").splitlines()
    pin = re.compile(r"[a-z0-9][a-z0-9-]*==[0-9][^ ]*( ; [^/\\]+)? \\")
    digest = re.compile(r"    --hash=sha256:[0-9a-f]{64}( \\)?")
    assert len(lines) > 1000
    assert [line for line in lines if not (line.startswith("#") or pin.fullmatch(line) or digest.fullmatch(line))] == []
    assert [
        line for line in lines if line.startswith("#") and ("://" in line or "/" in line.replace("deploy/", ""))
    ] == []


@pytest.mark.parametrize("name", LOCKS)
def test_every_pin_has_a_hash(name: str) -> None:
    text = (ROOT / "deploy" / name).read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    assert len(lines) > 40
    assert [line for line in lines if "--hash=sha256:" not in line] == []


def test_the_test_lock_is_the_runtime_lock_and_more() -> None:
    runtime, test = pins(LOCKS[0]), pins(LOCKS[1])
    assert len(test) > len(runtime)
    assert {name: version(pin) for name, pin in runtime.items()} == {name: version(test[name]) for name in runtime}


def test_the_compiler_is_the_one_that_a_build_asks_for() -> None:
    [(name, pin)] = pins("requirements-compiler.lock").items()
    assert f"{name}=={version(pin)}" == ZIG


@pytest.mark.parametrize(
    ("lock", "extras"), [("requirements.lock", ["hil"]), ("requirements-test.lock", ["hil", "test"])]
)
def test_pyproject_is_met(lock: str, extras: list[str]) -> None:
    """A dependency was added or raised and the lock was not made anew: sh deploy/lock.sh."""
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = pyproject["project"]
    wanted = [*pyproject["build-system"]["requires"], *project["dependencies"]]
    wanted += [line for extra in extras for line in project["optional-dependencies"][extra]]
    requirements = [Requirement(line) for line in wanted if not line.startswith("heft-flight[")]
    locked = pins(lock)
    unmet = [
        str(requirement)
        for requirement in requirements
        if (pin := locked.get(canonicalize_name(requirement.name))) is None
        or not requirement.specifier.contains(version(pin))
    ]
    assert unmet == []
