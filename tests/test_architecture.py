"""The rules of the rooms, read off the source: who may import whom, what core files must not touch, and how large a file may grow.

Each rule is a function from a source file to its offences, and each has a small offender of its own that it must find.
"""

import ast
import importlib
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("protocol", "agents", "world", "deploy")
MAY_IMPORT = {"protocol": {"protocol"}, "agents": {"agents", "protocol"}, "world": {"world", "protocol"}, "deploy": set(ROOMS)}
ONLY_DEPLOY = {
    "cyclopts",
    "cryptography",
    "rich",
    "aiohttp",
    "matplotlib",
    "mcap",
    "prometheus_client",
    "pyarrow",
    "tomli_w",
    "dask",
    "distributed",
    "rerun",
}
SHELL = {  # the files where time, sockets and threads live; all others are core
    "protocol/live.py",
    "protocol/process.py",
    "protocol/endpoints.py",
    "protocol/arrival_queue.py",
    "protocol/sender_limits.py",
    "protocol/so_linger.py",
    "protocol/stdin.py",
    "agents/__main__.py",
    "agents/compiled/warmup.py",
    "world/__main__.py",
}
OUTSIDE_WORLD = {"random", "secrets", "uuid", "time", "datetime", "socket", "asyncio", "threading", "subprocess", "multiprocessing"}
PURE_RANDOM = {"Generator", "PCG64", "BitGenerator", "SeedSequence"}
STRANGER = "deploy/examples/stranger.py"
BRIDGE = "deploy/bridge/"
MOST_LINES = 450  # the subject decides where a file ends; this only asks whether there are two
AGENT_PACKAGES = {
    "numpy",
    "msgspec",
    "zenoh",
    "shapely",
    "protocol",
    "agents",
    "typing_extensions",
}  # msgspec loads the last when it is there


class Source(NamedTuple):
    """One Python file of a room: its path from the root and its text."""

    path: str
    text: str

    @property
    def room(self) -> str:
        """The folder that it lies in."""
        return self.path.partition("/")[0]

    @property
    def is_core(self) -> bool:
        """Whether clocks, sockets and global random numbers are forbidden here."""
        return self.room != "deploy" and self.path not in SHELL


Rule = Callable[[Source], list[str]]


@cache
def parsed(source: Source) -> ast.Module:
    """The syntax tree of a file, which all rules share."""
    return ast.parse(source.text)


@cache
def nodes(source: Source) -> tuple[ast.AST, ...]:
    """All nodes of that tree."""
    return tuple(ast.walk(parsed(source)))


@cache
def sources() -> tuple[Source, ...]:
    """All Python files of the four rooms."""
    files = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
    return tuple(Source(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8")) for path in files)


def imported(source: Source) -> list[str]:
    """Dotted names of all modules that a file imports, anywhere in it; relative imports begin with a dot."""
    names: list[str] = []
    for node in nodes(source):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names.append("." * node.level + (node.module or ""))
    return names


def packages(source: Source) -> set[str]:
    """Top-level packages that a file imports."""
    return {name.partition(".")[0] for name in imported(source)}


def foreign_rooms(source: Source) -> list[str]:
    """protocol imports no room; agents and world import protocol alone, never each other; deploy may import all."""
    return sorted(packages(source) & set(ROOMS) - MAY_IMPORT[source.room])


def imports_of_tests(source: Source) -> list[str]:
    """No room imports the tests."""
    return sorted(packages(source) & {"tests", "conftest", "pytest", "hypothesis"})


def zenoh_outside_live(source: Source) -> list[str]:
    """Only protocol/live.py imports zenoh, and the examples that share nothing with ours."""
    theirs = source.path in ("protocol/live.py", STRANGER) or source.path.startswith(BRIDGE)
    return sorted(packages(source) & {"zenoh"}) if not theirs else []


def ours_in_the_stranger(source: Source) -> list[str]:
    """The example agent imports the standard library, zenoh and msgpack alone; the bridge besides rosbags and its own folder."""
    bridge = source.path.startswith(BRIDGE)
    theirs = {"zenoh", "msgpack", *(["rosbags", "deploy"] if bridge else [])}
    ours = [name for name in imported(source) if name.startswith("deploy") and not name.startswith("deploy.bridge.")] if bridge else []
    return sorted({*ours, *(packages(source) - sys.stdlib_module_names - theirs)}) if bridge or source.path == STRANGER else []


def heavy_outside_deploy(source: Source) -> list[str]:
    """Command line, pages, figures and recordings are matters of deploy."""
    return sorted(packages(source) & ONLY_DEPLOY) if source.room != "deploy" else []


def clocks_and_sockets_in_core(source: Source) -> list[str]:
    """Core files have no clock, no socket, no thread and no random numbers of their own."""
    return sorted(packages(source) & OUTSIDE_WORLD) if source.is_core else []


def global_randomness_in_core(source: Source) -> list[str]:
    """Of numpy.random, core files name only what carries its own state."""
    if not source.is_core:
        return []
    attributes = [node for node in nodes(source) if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute)]
    named = [node.attr for node in attributes if ast.unparse(node.value) in ("np.random", "numpy.random")]
    taken = [
        alias.name for node in nodes(source) if isinstance(node, ast.ImportFrom) and node.module == "numpy.random" for alias in node.names
    ]
    return [name for name in named + taken if name not in PURE_RANDOM]


def star_and_relative_imports(source: Source) -> list[str]:
    """Imports are absolute and name what they take."""
    stars = [
        f"line {node.lineno}: from {node.module} import *"
        for node in nodes(source)
        if isinstance(node, ast.ImportFrom) and any(alias.name == "*" for alias in node.names)
    ]
    return stars + [name for name in imported(source) if name.startswith(".")]


def modules_named_in_strings(source: Source) -> list[str]:
    """No text names a module of a room: a wheel has it under another name. `deploy.installation.command` translates its argument."""
    calls = [node for node in nodes(source) if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant)]
    translated = {id(node.args[0]) for node in calls if ast.unparse(node.func).endswith("command")}
    texts = [
        node for node in nodes(source) if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in translated
    ]
    return [
        f"line {node.lineno}: {node.value}"
        for node in texts
        if not node.value.endswith(".toml") and re.fullmatch(rf"({'|'.join(ROOMS)})(\.[a-z_]+)+(:\w+)?", node.value)
    ]


def too_long(source: Source) -> list[str]:
    """A file that outgrows its budget is two files."""
    lines = len(source.text.splitlines())
    return [f"{lines} lines, at most {MOST_LINES}"] if lines > MOST_LINES else []


def no_module_docstring(source: Source) -> list[str]:
    """Every file says in its first line what it holds."""
    return [] if ast.get_docstring(parsed(source)) else ["the module has no docstring"]


Definition = ast.FunctionDef | ast.AsyncFunctionDef


def public_definitions(source: Source) -> list[tuple[str, Definition | ast.ClassDef]]:
    """Public functions and classes of a file and the public methods of those classes, by dotted name."""
    found: list[tuple[str, Definition | ast.ClassDef]] = []
    for node in parsed(source).body:
        if not isinstance(node, Definition | ast.ClassDef) or node.name.startswith("_"):
            continue
        found.append((node.name, node))
        if isinstance(node, ast.ClassDef):
            found += [
                (f"{node.name}.{part.name}", part) for part in node.body if isinstance(part, Definition) and not part.name.startswith("_")
            ]
    return found


def unannotated(source: Source) -> list[str]:
    """Every parameter and every result of a public function has a type."""
    offences = []
    for name, node in public_definitions(source):
        if isinstance(node, ast.ClassDef):
            continue
        arguments = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
        bare = [argument.arg for argument in arguments if argument.annotation is None and argument.arg not in ("self", "cls")]
        offences += [f"{name}({argument})" for argument in bare] + ([f"{name} -> ?"] if node.returns is None else [])
    return offences


@cache
def documented_members() -> frozenset[str]:
    """Names of methods that have a docstring somewhere in the rooms, so that those which implement them need no second one."""
    return frozenset(
        name.partition(".")[2]
        for source in sources()
        for name, node in public_definitions(source)
        if "." in name and ast.get_docstring(node)
    )


def undocumented(source: Source) -> list[str]:
    """Every public function, class and method has a docstring, its own or that of the contract it fulfils."""
    return [
        name
        for name, node in public_definitions(source)
        if not ast.get_docstring(node) and not ("." in name and name.partition(".")[2] in documented_members())
    ]


def keyword_swallowers(source: Source) -> list[str]:
    """No **kwargs: a function says what it takes. A decorator says it by `P.kwargs` of a ParamSpec."""
    found = [node.args.kwarg for node in nodes(source) if isinstance(node, Definition) and node.args.kwarg]
    return [f"line {one.lineno}: **{one.arg}" for one in found if not isinstance(one.annotation, ast.Attribute)]


OFFENDERS: list[tuple[Rule, str, str]] = [
    (foreign_rooms, "protocol/x.py", "import agents.agent\n"),
    (foreign_rooms, "agents/x.py", "def f():\n    from world import targets\n"),
    (foreign_rooms, "world/x.py", "from agents.config import AgentConfig\n"),
    (foreign_rooms, "agents/x.py", "from deploy import scenario\n"),
    (imports_of_tests, "deploy/x.py", "from tests import helper\n"),
    (zenoh_outside_live, "protocol/x.py", "import zenoh\n"),
    (zenoh_outside_live, "deploy/x.py", "from zenoh.ext import z_serialize\n"),
    (ours_in_the_stranger, STRANGER, "from protocol.keys import order\n"),
    (ours_in_the_stranger, STRANGER, "import numpy as np\n"),
    (ours_in_the_stranger, "deploy/bridge/x.py", "from protocol.keys import order\n"),
    (ours_in_the_stranger, "deploy/bridge/x.py", "from deploy.scenario import Scenario\n"),
    (heavy_outside_deploy, "agents/x.py", "import matplotlib.pyplot as plt\n"),
    (clocks_and_sockets_in_core, "agents/x.py", "import random\n"),
    (clocks_and_sockets_in_core, "world/x.py", "from time import monotonic\n"),
    (clocks_and_sockets_in_core, "protocol/virtual.py", "from datetime import datetime\n"),
    (global_randomness_in_core, "world/x.py", "import numpy as np\nnp.random.seed(1)\n"),
    (global_randomness_in_core, "agents/x.py", "import numpy as np\nx = np.random.default_rng().random()\n"),
    (global_randomness_in_core, "agents/x.py", "from numpy.random import rand\n"),
    (star_and_relative_imports, "deploy/x.py", "from math import *\n"),
    (star_and_relative_imports, "world/x.py", "from .targets import Targets\n"),
    (modules_named_in_strings, "deploy/x.py", "run([python, '-m', 'deploy.live.zygote'])\n"),
    (modules_named_in_strings, "agents/x.py", "LAW = 'agents.coverage.pursuit:Pursuit'\n"),
    (too_long, "deploy/x.py", "x = 1\n" * (MOST_LINES + 1)),
    (no_module_docstring, "world/x.py", "x = 1\n"),
    (unannotated, "world/x.py", "def f(a) -> int: ...\n"),
    (unannotated, "world/x.py", "class C:\n    def f(self, a: int): ...\n"),
    (undocumented, "world/x.py", "def f() -> None: ...\n"),
    (undocumented, "world/x.py", "class C:\n    def nobody_else_has_this(self) -> None: ...\n"),
    (keyword_swallowers, "world/x.py", "def f(**kwargs): ...\n"),
]
RULES = list(dict.fromkeys(rule for rule, _, _ in OFFENDERS))


def test_every_file_of_the_rooms_keeps_all_rules() -> None:
    offences = [f"{source.path}: {offence}: {rule.__doc__}" for rule in RULES for source in sources() for offence in rule(source)]
    assert not offences, "\n".join(offences)


@pytest.mark.parametrize(
    ("rule", "path", "text"), OFFENDERS, ids=[f"{rule.__name__}-{number}" for number, (rule, _, _) in enumerate(OFFENDERS)]
)
def test_every_rule_finds_its_offender(rule: Rule, path: str, text: str) -> None:
    assert rule(Source(path, text))


def test_the_rules_look_at_all_four_rooms() -> None:
    assert {source.room for source in sources()} == set(ROOMS)
    assert {"protocol/messages.py", "agents/config.py", "world/config.py", "deploy/scenario.py"} <= {source.path for source in sources()}


@pytest.mark.parametrize("room", ROOMS)
def test_each_room_is_the_one_of_this_checkout_and_not_a_foreign_package_of_the_same_name(room: str) -> None:
    module = importlib.import_module(room)
    assert module.__file__ is not None
    assert Path(module.__file__).resolve() == ROOT / room / "__init__.py"


def test_every_package_is_installed_below_one_name_and_tests_find_them_without_installation() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    listed = settings["tool"]["setuptools"]["packages"]
    folders = {path.parent.relative_to(ROOT).as_posix().replace("/", ".") for room in ROOMS for path in (ROOT / room).rglob("__init__.py")}
    wanted = {f"covey.{folder}".replace("covey.deploy.interface.", "") for folder in folders}
    assert set(listed) == wanted, "pyproject.toml, tool.setuptools.packages: list every package, so that none is left out of a wheel"
    assert settings["tool"]["pytest"]["ini_options"]["pythonpath"] == [".", "deploy/interface"]


def loaded_by(module: str) -> set[str]:
    """Top-level packages outside the standard library that a fresh interpreter loads with a module."""
    program = f"import sys; before = set(sys.modules); import {module}; print(*sorted(set(sys.modules) - before))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    names = {name.partition(".")[0] for name in done.stdout.split()}
    return {name for name in names - set(sys.stdlib_module_names) if "cython" not in name}  # numpy's compiled parts register themselves


@pytest.mark.parametrize("module", ["agents.agent", "agents.__main__"])
def test_an_agent_loads_little_and_numba_only_when_compiled_kernels_are_asked_for(module: str) -> None:
    if not (ROOT / (module.replace(".", "/") + ".py")).exists():
        pytest.skip(f"{module} is not written yet")
    assert loaded_by(module) <= AGENT_PACKAGES


def test_the_world_process_loads_no_agent_and_the_protocol_room_loads_nobody() -> None:
    assert not loaded_by("world.config") & {"agents", "deploy"}
    assert loaded_by("protocol.codec, protocol.node, protocol.settings, protocol.random_streams, protocol.geometry") <= {
        "protocol",
        "numpy",
        "msgspec",
        "typing_extensions",
    }


def real_imports(tree: ast.AST) -> Iterator[str]:
    """Dotted names of what a file imports when it runs, anywhere in it: modules, and names taken from them."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            for other in node.orelse:
                yield from real_imports(other)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        else:
            yield from real_imports(node)


def module_of(source: Source) -> str:
    """The dotted name under which a file is imported in a checkout."""
    dotted = source.path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    return dotted.removeprefix("deploy.interface.")


def package_of(module: str) -> str:
    """The part of deploy that a module belongs to: `deploy.cli` of `deploy.cli.commands.run`, and `covey` of the Python interface."""
    return ".".join(module.split(".")[:2]) if module.startswith("deploy") else module.partition(".")[0]


def import_graph(files: Sequence[Source]) -> dict[str, set[str]]:
    """Which module imports which, of those that are among the files."""
    known = {module_of(source) for source in files}
    graph: dict[str, set[str]] = {}
    for source in files:
        names = [name for name in real_imports(parsed(source)) if name.partition(".")[0] in ("deploy", "covey")]
        found = {name if name in known else name.rpartition(".")[0] for name in names}
        graph[module_of(source)] = (found & known) - {module_of(source)}
    return graph


def packages_graph(graph: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The same between the parts of deploy."""
    found: dict[str, set[str]] = {}
    for module, imported in graph.items():
        own = package_of(module)
        found.setdefault(own, set()).update({package_of(other) for other in imported} - {own})
    return found


def cycle_of(graph: Mapping[str, set[str]]) -> list[str]:
    """A circle of imports; empty when there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def deploy_files() -> list[Source]:
    """The files of deploy."""
    return [source for source in sources() if source.room == "deploy"]


def test_neither_packages_nor_modules_of_deploy_import_in_circles() -> None:
    graph = import_graph(deploy_files())
    assert len(packages_graph(graph)) > 12 and sum(map(len, packages_graph(graph).values())) > 40
    assert cycle_of(packages_graph(graph)) == []
    assert cycle_of(graph) == []


def test_a_circle_of_packages_is_found_even_where_modules_have_none() -> None:
    files = [
        Source("deploy/a/one.py", "def f() -> None:\n    from deploy.b import two\n"),
        Source("deploy/b/two.py", "x = 1\n"),
        Source("deploy/b/three.py", "from deploy.a.four import x\n"),
        Source("deploy/a/four.py", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from deploy.b import three\nx = 1\n"),
    ]
    graph = import_graph(files)
    assert cycle_of(graph) == []
    assert set(cycle_of(packages_graph(graph))) == {"deploy.a", "deploy.b"}


def test_nothing_but_a_benchmark_imports_the_benchmarks() -> None:
    graph = packages_graph(import_graph(deploy_files()))
    assert [package for package, imported in graph.items() if "deploy.bench" in imported] == []
    assert "deploy.simulation" in graph["deploy.bench"]


def defined_types(source: Source) -> set[str]:
    """Classes of a file, and names in capitals and small letters that it gives to types."""
    tree = parsed(source)
    classes = {node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)}
    targets = [node.targets[0] for node in tree.body if isinstance(node, ast.Assign)]
    names = {target.id for target in targets if isinstance(target, ast.Name)}
    return classes | {name for name in names if name[0].isupper() and not name.isupper()}


def test_a_type_name_has_one_definition_in_the_project() -> None:
    places: dict[str, list[str]] = {}
    for source in sources():
        for name in defined_types(source):
            places.setdefault(name, []).append(source.path)
    twice = {name: paths for name, paths in places.items() if len(paths) > 1}
    assert twice == {}
