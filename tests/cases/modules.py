"""Modules of files that no package holds, as those of docs/ and examples/."""

import importlib.util
from pathlib import Path

ROOT = Path(__file__).parents[2]


def module_of(path):
    spec = importlib.util.spec_from_file_location(f"{path.parent.name}_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
