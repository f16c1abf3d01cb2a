"""The launcher says in one line what is missing, and starts fast once all is there."""

import ast
import hashlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def launch(folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The launcher of a copy of this checkout's first files, with nothing on the path."""
    for name in ("covey", "pyproject.toml"):
        (folder / name).write_bytes((ROOT / name).read_bytes())
    command = [sys.executable, str(folder / "covey"), *words]
    return subprocess.run(command, env={"PATH": "", **environment}, capture_output=True, text=True, timeout=60, check=False)


def test_a_python_without_venv_is_told_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "ensurepip.py").write_text("raise ImportError\n")
    done = launch(tmp_path, "demo", PYTHONPATH=str(tmp_path / "modules"))
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == "covey: this Python has no venv module: apt install python3-venv, or install uv"
    assert not (tmp_path / ".venv").exists()


def test_an_old_python_is_told_what_to_install(tmp_path: Path) -> None:
    source = (ROOT / "covey").read_text()
    assert "NEEDED = (3, 11)" in source
    (tmp_path / "pyproject.toml").write_bytes((ROOT / "pyproject.toml").read_bytes())
    (tmp_path / "covey").write_text(source.replace("NEEDED = (3, 11)", "NEEDED = (3, 99)"))
    done = subprocess.run(
        [sys.executable, str(tmp_path / "covey")], env={"PATH": ""}, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2
    have = f"{sys.version_info[0]}.{sys.version_info[1]}"
    assert (
        done.stderr == f"covey: this is Python {have}, Covey needs 3.99 or newer: apt install python3.99 python3.99-venv, or install uv\n"
    )


def test_the_launcher_is_written_in_words_that_python_3_6_reads() -> None:
    ast.parse((ROOT / "covey").read_text(), feature_version=(3, 6))


def test_an_environment_that_is_up_to_date_is_used_as_it_is(tmp_path: Path) -> None:
    stamp = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    python = tmp_path / ".venv" / "bin" / "python"
    python.write_text('#!/bin/sh\necho "$@ in $PYTHONPATH"\n')
    python.chmod(0o755)
    (tmp_path / ".venv" / "covey-installed").write_text(stamp + "\n")
    for own, kept in (("", ""), ("/my/laws::/lib", ":/my/laws:/lib")):
        done = launch(tmp_path, "up", "quick", PYTHONPATH=own)
        assert (done.returncode, done.stdout) == (0, f"-P -m deploy up quick in {tmp_path}:{tmp_path}/deploy/interface{kept}\n")


def test_mutants_are_planted_instead_of_the_usual_tests(tmp_path: Path) -> None:
    stamp = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    python = tmp_path / ".venv" / "bin" / "python"
    python.write_text('#!/bin/sh\necho "$@"\nexit 1\n')
    python.chmod(0o755)
    (tmp_path / ".venv" / "covey-installed").write_text(stamp + " study test\n")
    done = launch(tmp_path, "test", "--mutants", "12", "kappa")
    assert (done.returncode, done.stdout) == (1, "-m tests.mutants.run 12 kappa\n")


def test_a_changed_list_of_packages_is_installed_anew(tmp_path: Path) -> None:
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    python = tmp_path / ".venv" / "bin" / "python"
    python.write_text(f'#!/bin/sh\n[ "$1" = -c ] && exec {sys.executable} "$@"\necho "$@" >> {tmp_path}/calls\n')
    python.chmod(0o755)
    (tmp_path / ".venv" / "covey-installed").write_text("old\n")
    for _ in range(2):
        assert launch(tmp_path, "ps").returncode == 0
    calls = [call for call in (tmp_path / "calls").read_text().splitlines() if "--version" not in call]
    assert [call.split()[:3] for call in calls] == [
        ["-m", "pip", "install"],
        ["-P", "-m", "deploy"],
        ["-P", "-m", "deploy"],
    ]
    assert "eclipse-zenoh==1.10.2" in "".join(calls)


def test_an_environment_whose_setup_was_interrupted_is_made_anew(tmp_path: Path) -> None:
    (tmp_path / "uv").write_text(
        f"""#!/bin/sh
echo "$1" >> {tmp_path}/calls
[ "$1" = venv ] && /bin/mkdir -p {tmp_path}/.venv/bin && /bin/cp {tmp_path}/fake {tmp_path}/.venv/bin/python
[ "$1" = venv ] || ! [ -e {tmp_path}/broken ]
"""
    )
    (tmp_path / "fake").write_text(f'#!/bin/sh\n[ "$1" = -c ] && exec {sys.executable} "$@"\ntrue\n')
    for name in ("uv", "fake"):
        (tmp_path / name).chmod(0o755)
    (tmp_path / "broken").touch()
    assert launch(tmp_path, "ps", PATH=str(tmp_path)).returncode == 2
    (tmp_path / "broken").unlink()
    for _ in range(2):
        assert launch(tmp_path, "ps", PATH=str(tmp_path)).returncode == 0
    assert (tmp_path / "calls").read_text().split() == ["venv", "pip", "venv", "pip"]


@pytest.mark.slow
def test_two_launchers_at_once_set_up_one_after_the_other(tmp_path: Path) -> None:
    """The second waits, finds all done, and runs its command."""
    fake_environment(tmp_path / ".venv")
    python = tmp_path / ".venv" / "bin" / "python"
    python.write_text(python.read_text().replace('&& echo "$@" >>', '&& /bin/sleep 2 && echo "$@" >>'))
    for name in ("covey", "pyproject.toml"):
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    both = [
        subprocess.Popen([sys.executable, str(tmp_path / "covey"), "ps"], env={"PATH": ""}, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    said = sorted(process.communicate(timeout=60)[1] for process in both)
    assert [process.returncode for process in both] == [0, 0]
    assert said[0] == "covey: another ./covey is setting up; waiting for it\n"
    assert said[1].startswith("covey: setting up ")
    assert len((tmp_path / ".venv" / "installed").read_text().splitlines()) == 1


def fake_environment(folder: Path, interpreter: str = sys.executable) -> None:
    """An environment whose Python notes what it is asked to install, and says what it runs."""
    (folder / "bin").mkdir(parents=True)
    (folder / "lib" / "python3.99" / "site-packages").mkdir(parents=True)
    python = folder / "bin" / "python"
    asked = f'[ "$1" = -c ] && exec {interpreter} "$@"\n[ "$3" = --version ] && exit\n'
    asked += f'[ "$2" = pip ] && echo "$@" >> {folder}/installed && exit\n'
    program = asked + f'echo "{folder.name} $COVEY_LAUNCHER"\n'
    python.write_text("#!/bin/sh\n" + program)
    python.chmod(0o755)


def test_packages_of_an_extra_are_installed_when_a_command_asks_for_them_and_kept_from_then_on(tmp_path: Path) -> None:
    fake_environment(tmp_path / ".venv")
    assert launch(tmp_path, "demo").stderr.endswith(".venv; this takes a minute or two, once\n")
    asked = launch(tmp_path, "figures", "x", COVEY_EXTRAS="study")
    assert (asked.returncode, asked.stderr) == (0, "covey: installing what this command needs besides (study), once\n")
    assert asked.stdout == f".venv {tmp_path}/covey\n"
    calls = (tmp_path / ".venv" / "installed").read_text().splitlines()
    assert ["pyarrow" in call for call in calls] == [False, True]
    assert launch(tmp_path, "figures", "x", COVEY_EXTRAS="study").stderr == ""
    (tmp_path / "pyproject.toml").unlink()
    (tmp_path / ".venv" / "covey-installed").write_text("older study\n")
    launch(tmp_path, "demo")
    assert "pyarrow" in (tmp_path / ".venv" / "installed").read_text().splitlines()[-1]


def test_an_extra_that_is_unknown_or_cannot_be_had_leaves_what_is_there_as_it_is(tmp_path: Path) -> None:
    fake_environment(tmp_path / ".venv")
    assert launch(tmp_path, "demo").returncode == 0
    wrong = launch(tmp_path, "demo", COVEY_EXTRAS="mujuco")
    assert (wrong.returncode, wrong.stderr.splitlines()[-1]) == (
        2,
        "covey: COVEY_EXTRAS = 'mujuco': known are cluster, docs, mujoco, notebook, rerun, ros, study, test",
    )
    python = tmp_path / ".venv" / "bin" / "python"
    program = python.read_text()
    python.write_text(program.replace('[ "$2" = pip ] &&', '[ "$2" = pip ] && exit 1;'))
    python.chmod(0o755)
    failed = launch(tmp_path, "demo", COVEY_EXTRAS="cluster")
    assert failed.returncode == 2 and "set-up failed" in failed.stderr
    after = launch(tmp_path, "demo")
    assert (after.returncode, after.stderr) == (0, "")


def test_an_extra_of_before_that_is_known_no_more_is_let_go(tmp_path: Path) -> None:
    fake_environment(tmp_path / ".venv")
    (tmp_path / ".venv" / "covey-installed").write_text("old mujuco study\n")
    done = launch(tmp_path, "demo")
    assert (done.returncode, len(done.stderr.splitlines())) == (0, 1)
    assert (tmp_path / ".venv" / "covey-installed").read_text().split()[1:] == ["study"]
    assert "pyarrow" in (tmp_path / ".venv" / "installed").read_text()


def test_the_environment_finds_the_package_and_the_rooms_from_where_it_lies(tmp_path: Path) -> None:
    fake_environment(tmp_path / ".venv")
    launch(tmp_path, "demo")
    packages = tmp_path / ".venv" / "lib" / "python3.99" / "site-packages"
    lines = (packages / "covey.pth").read_text().splitlines()
    assert [(packages / line).resolve() for line in lines] == [tmp_path, tmp_path / "deploy" / "interface"]


def test_an_environment_of_another_user_is_used_while_it_is_ready_and_else_one_of_the_users_own_is_made() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder, root = Path(name), os.getuid() == 0
        interpreter = "/usr/bin/python3" if root else sys.executable  # that of root may lie where nobody else can read
        user = 65534 if root else None
        folder.chmod(0o755)
        caches = folder / "caches"
        caches.mkdir()
        caches.chmod(0o777)
        own = caches / "covey" / f"venv-{hashlib.sha256(str(folder).encode()).hexdigest()[:12]}"
        fake_environment(folder / ".venv", interpreter)
        launch(folder, "demo")
        fake_environment(own, interpreter)
        for path in (own.parent, own, *own.rglob("*")):
            path.chmod(0o777)
        for path in (folder, folder / ".venv"):
            path.chmod(0o555)
        command = [interpreter, str(folder / "covey"), "demo"]
        for extra, used in (("", ".venv"), ("study", own.name)):
            environment = {"PATH": "", "XDG_CACHE_HOME": str(caches), "COVEY_EXTRAS": extra}
            done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False, user=user)
            assert (done.returncode, done.stdout) == (0, f"{used} {folder}/covey\n"), done.stderr
        environment = {"PATH": "", "XDG_CACHE_HOME": "/proc/none", "COVEY_EXTRAS": "study"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False, user=user)
        assert done.returncode == 2 and "XDG_CACHE_HOME names a folder that can be written to" in done.stderr
        folder.chmod(0o755)
        (folder / ".venv").chmod(0o755)
