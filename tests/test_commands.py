"""The command line of the package: what it prints without a command, with a wrong one, and where something is missing."""

import subprocess
import sys

import pytest

from sb3_adaptive_q.__main__ import COMMANDS, main


@pytest.mark.parametrize("arguments", [[], ["-h"], ["--help"]])
def test_help_names_every_command(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    main(arguments)
    printed = capsys.readouterr().out
    assert printed.startswith("usage: python -m sb3_adaptive_q COMMAND")
    assert all(f"\n  {name} " in printed for name in COMMANDS)


def test_unknown_command() -> None:
    with pytest.raises(SystemExit, match=r"error: there is no command 'trian'\.\nusage: "):
        main(["trian"])


@pytest.mark.parametrize(
    ("command", "missing", "extra"), [("train", "rl_zoo3", "zoo"), ("study", "tyro", "study"), ("league", "tyro", "study")]
)
def test_missing_package_names_the_extra(command: str, missing: str, extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    module = COMMANDS[command][0]
    monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setitem(sys.modules, missing, None)
    message = rf"`{command}` needs the package {missing}, .*\n  pip install 'sb3-adaptive-q\[{extra}\]'"
    with pytest.raises(SystemExit, match=message):
        main([command])


def test_methods(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["methods"])
    assert not stop.value.code and "autostep" in capsys.readouterr().out


@pytest.mark.parametrize(("option", "code"), [("--help", 0), ("--env", 2)])
def test_methods_has_no_options(option: str, code: int, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["methods", option])
    printed = capsys.readouterr()
    assert stop.value.code == code and "usage: python -m sb3_adaptive_q methods" in printed.out + printed.err


def test_a_reader_that_has_seen_enough() -> None:
    """As `methods | head -1` does, which closes the pipe before all is printed."""
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "sb3_adaptive_q", "methods"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 1
