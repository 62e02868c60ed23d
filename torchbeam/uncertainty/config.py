"""Configuration of a run: a Python, JSON or TOML file with options of `monte_carlo`."""

from __future__ import annotations

import importlib
import importlib.util
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import torch

from ..core.arguments import boolean, keywords, level_of, number
from ..core.validation import refusal
from .given_law import of_text
from .monte_carlo import monte_carlo
from .monte_carlo_stream import monte_carlo_stream
from .output import LEVELS

OPTIONS = sorted(
    {*keywords(monte_carlo), *keywords(monte_carlo_stream)} - {"executor", "out", "progress"}
)
OWN = ("levels", "interval", "thresholds", "keep")  # of the answers, and whether samples are kept
KNOWN = ("function", "laws", "n", *OPTIONS, *OWN)
DTYPES = {"float32": torch.float32, "float64": torch.float64}


@dataclass(frozen=True)
class Config:
    """A run: function, laws and n, further options of `monte_carlo`; what is asked of the samples.

    modules     that the function's file was loaded as: workers on other machines get that file
    levels      of quantiles;  interval: confidence level;  thresholds: of exceedance;  keep:
                samples, or a summary
    """

    function: Any
    laws: Any
    n: int | None
    options: dict[str, Any]
    modules: tuple[ModuleType, ...] = ()
    levels: tuple[float, ...] = LEVELS
    interval: float = 0.95
    thresholds: tuple[float, ...] = ()
    keep: bool = True


def read(path: Path) -> Config:
    """The configuration in a file; ValueError where it is none."""
    if not path.is_file():
        raise ValueError(
            f"the file {str(path)!r} was given, which is not there; a configuration (.py, .json, "
            ".toml) is wanted"
        )
    if path.suffix == ".py":
        module = load(path)
        entries = {name: getattr(module, name) for name in KNOWN if hasattr(module, name)}
        modules: tuple[ModuleType, ...] = (module,)
    else:
        entries = _parsed(path)
        function, modules = _function(path, entries.pop("function", None))
        entries["function"] = function
        if isinstance(entries.get("laws"), dict):
            entries["laws"] = {name: of_text(name, law) for name, law in entries["laws"].items()}
        if "dtype" in entries:
            if entries["dtype"] not in DTYPES:
                raise refusal(f"dtype = {entries['dtype']!r}", "float32 or float64")
            entries["dtype"] = DTYPES[entries["dtype"]]
        if isinstance(entries.get("correlation"), dict):
            entries["correlation"] = {
                tuple(name.strip() for name in pair.split(",")): value
                for pair, value in entries["correlation"].items()
            }
        if isinstance(entries.get("sentences"), dict):
            entries["sentences"] = {
                int(code) if code.removeprefix("-").isdecimal() else code: text
                for code, text in entries["sentences"].items()
            }
        if unknown := [name for name in entries if name not in KNOWN]:
            raise ValueError(
                f"{unknown[0]!r} was given in {path.name}; {', '.join(KNOWN)} are there"
            )
    for name in ("function", "laws"):
        if entries.get(name) is None:
            raise refusal(f"{path.name} without {name}", "function, laws and n", are=True)
    if not callable(entries["function"]):
        raise ValueError(
            f"function = {entries['function']!r} was given in {path.name}; a function is wanted"
        )
    answers = {name: entries.pop(name) for name in OWN if name in entries}
    answers |= {
        name: _numbers(name, answers[name]) for name in ("levels", "thresholds") if name in answers
    }
    if not all(0 <= level <= 1 for level in answers.get("levels", ())):
        raise ValueError(
            f"levels = {answers['levels']} were given in {path.name}; probabilities are wanted"
        )
    level_of("interval", answers.get("interval", Config.interval))
    boolean("keep", answers.get("keep", Config.keep))
    run = [entries.pop(name, None) for name in ("function", "laws", "n")]
    return Config(*run, entries, modules, **answers)


def load(path: Path) -> ModuleType:
    """A file as a module of its name, importable elsewhere too; ValueError if that is taken."""
    path, name = path.resolve(), path.stem
    loaded = sys.modules.get(name)
    if loaded is not None and getattr(loaded, "__file__", None) == str(path):
        return loaded
    if not name.isidentifier():
        raise refusal(f"the file {path.name!r}", "a name that Python can import")
    sys.path.insert(0, str(path.parent))
    importlib.invalidate_caches()
    spec = None if loaded is not None else importlib.util.find_spec(name)
    if spec is None or spec.origin != str(path):
        sys.path.remove(str(path.parent))
        raise ValueError(
            f"the file {path.name!r} was given, and another module is called {name!r}; another "
            "name is wanted"
        )
    return importlib.import_module(name)


def _function(path: Path, text: Any) -> tuple[Any, tuple[ModuleType, ...]]:
    """Function of "model.py:name", beside the configuration, or of "package.module:name"."""
    place, _, name = text.rpartition(":") if isinstance(text, str) else ("", "", "")
    if not place or not name:
        raise ValueError(
            f'function = {text!r} was given in {path.name}; "FILE.py:NAME" or "MODULE:NAME" is '
            "wanted"
        )
    if place.endswith(".py"):
        file = path.parent / place
        if not file.is_file():
            raise ValueError(
                f"function = {text!r} was given in {path.name}, and {str(file)!r} is not there"
            )
        module = load(file)
    else:
        try:
            module = importlib.import_module(place)
        except ImportError as error:
            raise ValueError(
                f"function = {text!r} was given in {path.name}, and {place!r} is not there "
                f"({error})"
            ) from None
    if not hasattr(module, name):
        raise ValueError(
            f"function = {text!r} was given in {path.name}, and {place!r} has no {name!r}"
        )
    return getattr(module, name), (module,) if place.endswith(".py") else ()


def _numbers(name: str, values: Any) -> tuple[float, ...]:
    if not isinstance(values, (list, tuple)):
        raise refusal(f"{name} = {values!r}", "a list of numbers")
    return tuple(number(name, x) for x in values)


def _parsed(path: Path) -> dict[str, Any]:
    if path.suffix not in (".json", ".toml"):
        raise refusal(f"the file {path.name!r}", "one that ends in .py, .json or .toml")
    try:
        if path.suffix == ".json":
            content = json.loads(path.read_text())
        else:
            import tomllib

            content = tomllib.loads(path.read_text())
    except ImportError:
        raise ValueError(
            f"the file {path.name!r} was given; TOML wants Python 3.11 or later, JSON does not"
        ) from None
    except ValueError as error:
        raise ValueError(f"{path.name} cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise refusal(
            f"{path.name} that holds a {type(content).__name__}", "names with values", are=True
        )
    return content
