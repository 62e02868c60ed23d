"""The house: a folder imports only from those above it, and no two files import each other, not
even for a type.
"""

import ast
import importlib
import inspect
from functools import cache
from pathlib import Path

import pytest
import torchbeam_envs

import torchbeam

# From what knows nothing to what knows all:
LAYERS = (
    "math", "core", "uncertainty", "topology", "cross_section", "scene", "readers", "state",
    "nodal", "solvers", "equations", "engine", "dynamics", "mixed", "statics", "linear", "sensors",
    "plot", "analysis", "cli", "extend",
)  # fmt: skip
HERE = Path(__file__).parents[2]
ROOTS = {
    "torchbeam": Path(torchbeam.__file__).parent,
    "torchbeam_envs": Path(torchbeam_envs.__file__).parent,
}


def modules(package):
    """Dotted name -> file."""
    root = ROOTS[package]
    found = {}
    for path in sorted(root.rglob("*.py")):
        parts = (package, *path.relative_to(root).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def import_nodes(path):
    """Import statements of a file, wherever they stand."""
    tree = ast.walk(ast.parse(path.read_text()))
    return [node for node in tree if isinstance(node, (ast.Import, ast.ImportFrom))]


def imports(name, path, known):
    """Modules of the project that a file imports anywhere: for types and inside functions too."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in import_nodes(path):
        if isinstance(node, ast.ImportFrom):
            above = (
                package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            )
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                full = f"{base}.{alias.name}"
                yield from (x for x in (full if full in known else base,) if x in known)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)


@cache
def graph(package):
    known = modules(package)
    return {name: set(imports(name, path, known)) - {name} for name, path in known.items()}


def circles(arrows):
    """Groups of files that reach each other."""
    reach = {name: set() for name in arrows}
    for name in arrows:
        todo = [name]
        while todo:
            for other in arrows.get(todo.pop(), ()):
                if other not in reach[name]:
                    reach[name].add(other)
                    todo.append(other)
    return sorted(
        {
            tuple(sorted(x for x in reach[name] if name in reach[x]))
            for name in arrows
            if name in reach[name]
        }
    )


def test_no_two_files_import_each_other():
    for package in ROOTS:
        assert circles(graph(package)) == []


def test_folders_import_from_those_above_alone():
    def floor(name):  # the whole of it is what the command line sees
        return LAYERS.index(name.split(".")[1] if "." in name else "cli")

    wrong = [
        f"{name} -> {other}"
        for name, others in graph("torchbeam").items()
        for other in sorted(others)
        if name.count(".") and "__main__" not in name and floor(other) > floor(name)
    ]
    assert wrong == []


def test_the_derivations_element_is_imported_where_it_is_asked_for():
    """Through `dynamics.forms` alone: no file of others names its package, but for types of the
    public names. (`test_imports.py` sees what a process loads.)
    """
    package = "torchbeam.mixed"
    users = {
        name
        for name, others in graph("torchbeam").items()
        if not name.startswith(package) and any(other.startswith(package) for other in others)
    }
    told = {
        name
        for name, path in modules("torchbeam").items()
        if not name.startswith(package) and f'"{package}' in path.read_text()
    }
    assert users == {"torchbeam"} and told == {"torchbeam.dynamics.forms"}


PHYSICS = (
    "nodal.assembly", "nodal.balance", "nodal.frame", "nodal.mass_offset", "nodal.loads",
    "nodal.mass", "nodal.rows", "equations.alpha_kinematics",
    "equations.energy_projection", "equations.step_element", "equations.step_kinematics",
    "equations.steady_motion",
)  # fmt: skip


def test_physics_reads_rows_and_no_scene():
    """What is said of nodes and elements by themselves imports neither a scene nor the model of
    one.
    """
    arrows = graph("torchbeam")
    wholes = {"torchbeam.scene.scene", "torchbeam.nodal.model", "torchbeam.scene.beam"}
    for name in PHYSICS:
        assert not arrows[f"torchbeam.{name}"] & wholes, name


ABOVE = "torchbeam_envs", "gymnasium", "studies", "training", "examples", "cases"


def test_torchbeam_knows_neither_environments_nor_gymnasium():
    for path in modules("torchbeam").values():
        for node in import_nodes(path):
            names = (
                [node.module or ""]
                if isinstance(node, ast.ImportFrom) and not node.level
                else ([alias.name for alias in node.names] if isinstance(node, ast.Import) else [])
            )
            assert not any(name.split(".")[0] in ABOVE for name in names), path


PUBLIC = (
    "torchbeam", "torchbeam.extend", "torchbeam.extend.commands", "torchbeam.plot",
    "torchbeam.sensors", "torchbeam_envs", "torchbeam_envs.baselines", "torchbeam_envs.functional",
)  # fmt: skip
# what a command runs, for those who run parts of it
DEMO = "torchbeam_envs.demo"
# folder -> the package alone that the rule is about there; "" = both
OUTSIDE = {
    "envs": "torchbeam", "training": "", "cases": "", "examples": "", "tests/properties": "",
    "tests/verification": "", "tests/envs": "torchbeam",
}  # fmt: skip


@pytest.mark.parametrize("folder", OUTSIDE)
def test_outside_the_library_only_public_names_are_used(folder):
    wrong = []
    for path in sorted((HERE / folder).rglob("*.py")):
        for node in import_nodes(path):
            names = (
                [node.module]
                if isinstance(node, ast.ImportFrom) and not node.level
                else [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else []
            )
            wrong += [
                f"{path.relative_to(HERE)}: {name}"
                for name in names
                if name.split(".")[0] in ("torchbeam", "torchbeam_envs")
                and (not OUTSIDE[folder] or name.split(".")[0] == OUTSIDE[folder])
                and name not in PUBLIC
                and not name.startswith(DEMO)
            ]
    assert wrong == []


# what studies take of the library that has no public name, and for what
STUDIES_INSIDE = {
    # the search of `converge`, and how its fits follow many starts: what is measured itself
    "torchbeam.analysis.convergence": "reading remesh search setting trials",
    "torchbeam.analysis.identification": "experiment parameters refinement",
    "torchbeam.solvers": "jacobian least_squares",
    "torchbeam.analysis": "advise",  # seconds of runs in turns
    # command lines, rows of measurements (public as `extend.commands.measurement`), peak memory
    "torchbeam.core": "command_line measurement memory",
    "torchbeam.dynamics": "dense_output tolerance",  # errors of adaptive steps
    # parts of a native step, what is compiled, and why a load is not
    "torchbeam.engine.chain": "coverage native",
    "torchbeam.engine.compiler": "function library llvm loop_text",
    "torchbeam.nodal": "discretise",
    "torchbeam.math": "distributions",  # intervals of counts
    "torchbeam.mixed": "minimal model rates state",  # the routes of its rates
    "torchbeam.plot": "canvas",
    "torchbeam.statics": "continuation",  # which points are limits of a path
}


def test_studies_use_public_names_and_these():
    """The list grows by no accident, and shrinks where a name becomes public."""
    inside = {
        f"{above}.{name}" for above, names in STUDIES_INSIDE.items() for name in names.split()
    }
    known, found = modules("torchbeam"), set()
    for path in sorted((HERE / "studies").rglob("*.py")):
        found.update(imports(".".join(path.relative_to(HERE).with_suffix("").parts), path, known))
    assert found - set(PUBLIC) == inside


def test_what_knows_no_interaction_by_name():
    """Balances, steps, matrices and solvers ask all that acts between nodes alike."""
    names = "balance_problem step_problem midpoint generalized_alpha load_steps"
    files = [f"equations/{name}.py" for name in names.split()]
    names = "elimination framework_matrix framework_system framework_unknowns"
    files += [f"topology/{name}.py" for name in names.split()]
    files += ["nodal/balance.py", "nodal/multipliers.py"]
    paths = [ROOTS["torchbeam"] / file for file in files]
    paths += sorted((ROOTS["torchbeam"] / "solvers").glob("*.py"))
    texts = {path.name: path.read_text().lower() for path in paths}
    words = "joint", "tendon", "touching"
    assert {file for file, text in texts.items() if any(word in text for word in words)} == set()


def test_public_modules_say_what_is_public():
    for name in PUBLIC:
        module = importlib.import_module(name)
        assert [public for public in module.__all__ if not hasattr(module, public)] == [], name


def test_a_circle_is_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [("a", "b", "c")]


@pytest.mark.parametrize(
    "name",
    [
        "simulate",
        "equilibrium",
        "path",
        "modes",
        "linearize",
        "critical_load",
        "identify",
        "identify_fields",
        "design",
        "compare",
        "ExplicitStepper",
    ],
)
def test_signatures_say_every_option(name):
    """What an editor completes is all there is: no **options."""
    parameters = inspect.signature(getattr(torchbeam, name)).parameters.values()
    assert not any(p.kind is p.VAR_KEYWORD for p in parameters)
