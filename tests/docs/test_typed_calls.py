"""The calls whose types `make lint` checks are calls that run, and give what they are annotated
with; and a type checker sees the signatures that there are.
"""

import inspect
import re

import pytest
import torch

import torchbeam as tb
from torchbeam import extend


def test_typed_calls_run(monkeypatch):
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")
    from tests.cases import typed_calls

    for name, kind in typed_calls.__annotations__.items():
        kind = getattr(kind, "__origin__", kind)
        assert isinstance(getattr(typed_calls, name), kind), name
    assert {torch.Tensor, tb.State, tb.Solution} < set(typed_calls.__annotations__.values())


def signature(kind):
    """Names of the arguments, of what is given by name alone after a *, and = where there is a
    default.
    """
    said = []
    for name, argument in inspect.signature(kind).parameters.items():
        if argument.kind is argument.KEYWORD_ONLY and "*" not in said:
            said.append("*")
        said.append(name + ("" if argument.default is argument.empty else "="))
    return said


@pytest.mark.long
def test_a_type_checker_sees_the_signatures_that_there_are(tmp_path):
    api = pytest.importorskip("mypy.api")
    public = {name: getattr(tb, name) for name in tb.__all__}
    kinds = {
        name: kind
        for name, kind in public.items()
        if isinstance(kind, type) and issubclass(kind, extend.Tree) and "__init__" in vars(kind)
    }
    file = tmp_path / "signatures.py"
    asked = [f"reveal_type(tb.{name}.__init__)" for name in kinds]
    file.write_text("\n".join(("import torchbeam as tb", *asked)))
    answer = api.run([str(file), "--no-pretty", "--cache-dir", str(tmp_path)])
    seen = re.findall(r'Revealed type is "def \(self: (.*)\)"', answer[0])
    assert len(seen) == len(kinds) > 20, answer
    for (name, kind), text in zip(kinds.items(), seen, strict=True):
        while text != (text := re.sub(r"[\[(][^][()]*[\])]", "", text)):  # what stands in brackets
            pass
        arguments = [re.sub(r": [^=]*?( =|$)", r"\1", a).replace(" ", "") for a in text.split(", ")]
        assert arguments[1:] == signature(kind), name
