"""Which module may import which: the way of the data, and what must stay out of an FMU."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "ndob_fmu"
SLAVES = sorted((ROOT / "fmus").glob("*slave*.py"))
CARRIED = ("ndob_fmu.runtime", "ndob_fmu.interface")  # inside every FMU
HEAVY = (
    "scipy",
    "sympy",
    "fmpy",
    "pythonfmu",
    "matplotlib",
    "pint",
    "distributed",
    "pyarrow",
    "plotly",
    "jinja2",
    "dash",
)


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imports(path, *, late=True):
    """Return the full names that a module imports, without those for type checkers; `late`: also inside functions."""
    found = set()

    def visit(node):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            return
        if isinstance(node, ast.FunctionDef) and not late:
            return
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import, which the bundle for FMUs would not rename"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found.add(whole if whole in MODULES else node.module)
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(path.read_text("utf-8")))
    return found


def within(name, *packages):
    return any(name == package or name.startswith(f"{package}.") for package in packages)


@pytest.mark.parametrize("name", [name for name in MODULES if within(name, *CARRIED)])
def test_what_runs_inside_an_fmu_imports_numpy_the_standard_library_and_itself(name):
    for imported in imports(MODULES[name]):
        top = imported.partition(".")[0]
        assert within(imported, *CARRIED) or top == "numpy" or top in sys.stdlib_module_names, imported


@pytest.mark.parametrize("path", SLAVES, ids=lambda path: path.stem)
def test_a_slave_imports_the_runtime_and_pythonfmu_besides(path):
    for imported in imports(path):
        top = imported.partition(".")[0]
        allowed = within(imported, *CARRIED, "fmus", "pythonfmu", "numpy")
        assert allowed or top in sys.stdlib_module_names, imported


# What each folder may import besides itself, in the order of the way of the data. CONTRIBUTING.md says why.
LEAVES = ("errors", "support", "runtime.arrays")
ALLOWED = {
    "runtime": (),
    "interface": ("runtime",),
    "errors": ("runtime.base_errors",),
    "support": ("errors", "runtime.arrays", "runtime.base_errors"),
    "model": (*LEAVES, "runtime", "interface"),
    "codegen": (*LEAVES, "runtime", "model"),
    "analysis": (*LEAVES, "runtime", "model", "codegen"),
    "fmu": (*LEAVES, "runtime", "interface", "model", "codegen", "analysis"),
    "native": (*LEAVES, "runtime", "interface", "model", "codegen", "analysis", "fmu"),
    "results": LEAVES,
    "cosim": (*LEAVES, "runtime.base_errors", "results"),
    "log": (*LEAVES, "runtime", "interface", "model", "codegen", "native", "results"),
    "study": (*LEAVES, "results", "cosim"),
    "report": (*LEAVES, "results", "study"),
    "packages": (*LEAVES, "fmu", "native", "cosim"),
    "demo": (*LEAVES, "results", "cosim"),
    "command_line": (
        *LEAVES,
        "model",
        "analysis",
        "fmu",
        "native",
        "results",
        "log",
        "cosim",
        "packages",
        "study",
        "report",
        "demo",
    ),
    "cli": (*LEAVES, "command_line"),
    "__main__": ("cli",),
}


@pytest.mark.parametrize("name", [name for name in MODULES if name != "ndob_fmu"])
def test_a_folder_imports_only_those_before_it_on_the_way_of_the_data(name):
    """So `cosim` and `study` know neither model nor observer, and couple any FMUs."""
    room = name.split(".")[1]
    allowed = ["ndob_fmu", f"ndob_fmu.{room}", *(f"ndob_fmu.{other}" for other in ALLOWED[room])]
    own = {imported for imported in imports(MODULES[name]) if within(imported, "ndob_fmu")}
    assert [imported for imported in own if imported != "ndob_fmu" and not within(imported, *allowed[1:])] == []


# The same inside a folder: what each of its parts may import of the others.
_RUNTIME_BASE = ("arrays", "base_errors", "memo", "times")
_RUNTIME_PLANT = (*_RUNTIME_BASE, "numerics", "linear_part", "generated_steps", "equations")
_COSIM_BASE = ("component", "values", "time_grid", "default_experiment")
ALLOWED_INSIDE = {
    "runtime": {
        **dict.fromkeys(_RUNTIME_BASE, ()),
        "numerics": _RUNTIME_BASE,
        "linear_part": _RUNTIME_BASE,
        "equations": (*_RUNTIME_BASE, "linear_part", "generated_steps"),
        "generated_steps": _RUNTIME_BASE,
        "design": _RUNTIME_PLANT,
        "step": (*_RUNTIME_PLANT, "design"),
        "blocks": _RUNTIME_PLANT,
    },
    "cosim": {
        **dict.fromkeys(_COSIM_BASE, ("component",)),
        "fmi": _COSIM_BASE,
        "system": (*_COSIM_BASE, "fmi"),
        "master": (*_COSIM_BASE, "system"),
        "ssp": (*_COSIM_BASE, "fmi", "system"),
        "simulation": (*_COSIM_BASE, "fmi", "system", "master", "ssp"),
        "run_folder": (*_COSIM_BASE, "system", "simulation"),
    },
}


@pytest.mark.parametrize(
    "name", [name for name in MODULES if name.count(".") > 1 and name.split(".")[1] in ALLOWED_INSIDE]
)
def test_a_part_of_a_folder_imports_only_those_before_it(name):
    """So what a design computes once knows nothing of the steps, and the numerical methods nothing of the plant."""
    _, folder, part = name.split(".")[:3]
    allowed = [f"ndob_fmu.{folder}.{other}" for other in (part, *ALLOWED_INSIDE[folder][part])]
    own = {imported for imported in imports(MODULES[name]) if within(imported, f"ndob_fmu.{folder}")}
    assert [imported for imported in own if not within(imported, *allowed)] == []


@pytest.mark.parametrize(
    ("package", "users", "command"),
    [
        ("ndob_fmu.study", ("ndob_fmu.study", "ndob_fmu.report"), "study_commands"),
        ("ndob_fmu.report", ("ndob_fmu.report",), "study_commands"),
        ("ndob_fmu.log.tune.serve", (), "log_commands"),
        ("dash", ("ndob_fmu.log.tune.page",), None),
    ],
)
def test_what_needs_an_extra_is_imported_by_the_commands_that_ask_for_it_only(package, users, command):
    found = {name for name, path in MODULES.items() if any(within(i, package) for i in imports(path))}
    wanted = set() if command is None else {f"ndob_fmu.command_line.{command}"}
    assert {name for name in found if not within(name, *users)} == wanted


def test_only_the_program_itself_imports_the_command_line():
    users = [name for name, path in MODULES.items() if "ndob_fmu.cli" in imports(path)]
    assert users == ["ndob_fmu.__main__"]


def test_there_is_no_import_cycle():
    graph = {
        name: {imported for imported in imports(path, late=False) if imported in MODULES and imported != name}
        for name, path in MODULES.items()
    }
    assert len(list(TopologicalSorter(graph).static_order())) == len(
        MODULES
    )  # raises CycleError, which names the cycle


@pytest.mark.parametrize(
    "statement", ["import ndob_fmu", "import ndob_fmu.runtime.step.paper_observer, ndob_fmu.runtime.blocks.plant"]
)
def test_the_root_and_the_core_load_none_of_the_heavy_packages(statement):
    program = f"import sys; {statement}; print(sorted(set({HEAVY!r}) & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("before", ["", "import ndob_fmu.cli, ndob_fmu.analysis.design;", "from ndob_fmu import *;"])
def test_what_the_root_promises_is_there_whatever_was_imported_before(before):
    """No submodule may have the name of a function of the root, which it would hide."""
    program = f"{before}from ndob_fmu import Model, NdobError, build, check, design, load_model, simulate;"
    program += "import ndob_fmu; print(all(map(callable, [ndob_fmu.design, Model, NdobError, build, check, design,"
    program += "load_model, simulate])))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout == "True\n"


def test_the_root_has_everything_it_lists_and_nothing_else():
    import ndob_fmu

    assert [name for name in ndob_fmu.__all__ if getattr(ndob_fmu, name, None) is None] == []
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        ndob_fmu.nonsense  # noqa: B018 # the access is what is tested
