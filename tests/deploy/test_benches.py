"""The benches run one after another: what each printed is kept, and one that fails is reported."""

import importlib
from pathlib import Path

import pytest

from bench import all as benches
from bench import mutants
from bench.all import BENCHES, ROOT, BenchResult, Job, run


def test_every_bench_is_there_under_a_name_of_its_own() -> None:
    assert len({bench.name for bench in BENCHES}) == len(BENCHES)
    for bench in BENCHES:
        path = ROOT / "bench" / bench.module
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), bench.module


def test_every_mutant_still_has_its_line_and_its_test() -> None:
    every = mutants.read(mutants.LIST)
    assert len(every) >= 30
    for one in every:
        assert mutants.mutated(one, ROOT) != (ROOT / one.file).read_text(encoding="utf-8"), one
        file, *names = one.test.split("[", maxsplit=1)[0].split("::")
        text = (ROOT / file).read_text(encoding="utf-8")
        assert all(f"def {name}(" in text or f"class {name}" in text for name in names), one


def test_what_a_bench_printed_is_kept_and_one_that_fails_is_told(tmp_path: Path) -> None:
    done = run(Job("acquisition", "--no-such-option"), True, tmp_path)
    assert done[:3] == ("acquisition", "python -m bench.acquisition --no-such-option", "2: failed, or missed a bar")
    assert "unrecognized arguments: --no-such-option" in (tmp_path / "acquisition.txt").read_text(encoding="utf-8")
    assert done.cpu_s > 0.0
    assert run(Job("acquisition", "--help", label="help"), True, tmp_path).said == "ok"


def test_a_page_says_how_it_was_made_and_names_no_directory_of_this_machine(tmp_path: Path) -> None:
    done = BenchResult("big_arms", f"python -m bench.arms {benches.DATASETS}/arm", "ok", 9.0, 7.4)
    benches.page(
        done, "a machine", f"heft: 5 %, 2 s so far\n0.58 % in {benches.DATASETS}/arm\n", tmp_path / "big_arms.md"
    )
    text = (tmp_path / "big_arms.md").read_text(encoding="utf-8")
    assert text.startswith("# Big arms\n\nMade by `python -m bench.all --only big_arms --pages docs/evidence`")
    assert "```text\n0.58 % in $HEFT_DATASETS/arm\n```" in text
    assert "`python -m bench.arms $HEFT_DATASETS/arm`: a machine, code" in " ".join(text.split())
    assert "7 s of CPU time, ok." in text
    assert str(benches.DATASETS) not in text
    assert benches.head_of("rocksat").startswith("# RockSat-X\n\nThe dissertation's flight, built off its drawing")


def test_one_without_its_recordings_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benches, "DATASETS", tmp_path)
    assert run(Job("arms", "", "", "no_arm"), True, tmp_path) == BenchResult(
        "arms", "python -m bench.arms", f"not run: no {tmp_path / 'no_arm'}"
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("honesty DIR", "is not the directory of a campaign"),
        ("identified_flights DIR/bad.mcap", "bad.mcap is no heft log"),
        ("identified_flights DIR/none.mcap", "there is no file"),
        ("longest_step DIR/bad.mcap", "bad.mcap is no heft log"),
        ("tudelft_accuracy DIR", "holds no *.npz"),
        ("captures --datasets DIR", "holds no workshop_tools/*"),
        ("arms --datasets DIR", "holds no staubli_tx40/*"),
        ("fuzz --replay DIR/none", "is no saved input"),
        ("speed --against DIR", "holds no onboard"),
        ("overload --vehicle DIR/bad.toml", "bad.toml: not TOML"),
        ("overload --vehicle DIR", "there are air_bearing, "),
        ("restarts --vehicle none", "invalid choice: 'none'"),
    ],
)
def test_what_is_given_wrongly_is_a_sentence_and_exit_code_2(
    command: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.mcap").write_text("not a log")
    (tmp_path / "bad.toml").write_text("not = [toml")
    bench, *arguments = command.replace("DIR", str(tmp_path)).split()
    monkeypatch.setattr("sys.argv", [bench, *arguments])
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(f"bench.{bench}").main()
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
