"""The house: a folder imports only from those above it, and no two files import each other, not even for a type."""

import ast
from pathlib import Path

import torchbeam_envs

import torchbeam

LAYERS = ("math", "core", "scene", "state", "nodal", "mixed", "solvers", "dynamics", "statics", "linear", "sensors", "plot",
          "analysis", "cli", "studies")  # from what knows nothing to what knows all
ROOTS = {"torchbeam": Path(torchbeam.__file__).parent, "torchbeam_envs": Path(torchbeam_envs.__file__).parent}


def modules(package):
    """Dotted name -> file."""
    root = ROOTS[package]
    found = {}
    for path in sorted(root.rglob("*.py")):
        parts = (package, *path.relative_to(root).with_suffix("").parts)
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports(name, path, known):
    """Modules of the project that a file imports anywhere: for types and inside functions too."""
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            above = package.split(".")[:len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                full = f"{base}.{alias.name}"
                yield from (x for x in (full if full in known else base,) if x in known)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)


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
    return sorted({tuple(sorted(x for x in reach[name] if name in reach[x])) for name in arrows if name in reach[name]})


def test_no_two_files_import_each_other():
    for package in ROOTS:
        assert circles(graph(package)) == []


def test_folders_import_from_those_above_alone():
    def floor(name):  # the whole of it is what studies see
        return LAYERS.index(name.split(".")[1] if "." in name else "studies")

    wrong = [f"{name} -> {other}" for name, others in graph("torchbeam").items() for other in sorted(others)
             if name.count(".") and "__main__" not in name and floor(other) > floor(name)]
    assert wrong == []


def test_torchbeam_knows_neither_environments_nor_gymnasium():
    for path in modules("torchbeam").values():
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else (
                [alias.name for alias in node.names] if isinstance(node, ast.Import) else [])
            assert not any(name.split(".")[0] in ("torchbeam_envs", "gymnasium", "training") for name in names), path


def test_a_circle_is_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [("a", "b", "c")]
