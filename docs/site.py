"""Writes what the site is built of into out/ (`make docs`): the pages of docs/, and those that are
made of other files: the guide of docs/README.md, a page of each example, the reference of all
public names, the changelog. Links out of docs/ go to those pages; what the site does not show is
named without a link.
"""

import ast
import importlib.util
import json
import posixpath
import re
import shutil
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
PACKAGES = ROOT / "out" / "packages"
EXAMPLES = sorted(path for path in (ROOT / "examples").glob("*.py"))
LEFT_OUT = ("*.py", "*.toml", "__pycache__", "runs", "README.md")  # of what lies in docs/

# What is public, by what it is for: title of a page, first sentence, names of `torchbeam`.
# fmt: off
REFERENCE = {
    "scene": ("Scenes", "What there is: beams, bodies, sections, and what holds and joins them.", (
        "Scene", "Beam", "Section", "CrossSection", "Material", "Stations", "Table", "Body",
        "Support", "Frame", "RootMotion", "Weld", "Ball", "Hinge", "Universal", "Slider",
        "Cylindrical", "Distance", "ElastoPlastic", "BoucWen", "Drive")),
    "effects": ("Effects", "What acts: only what a scene names exists.", (
        "Gravity", "TipLoad", "PointLoad", "LineLoad", "Load", "Actuation", "Tendon", "Drag",
        "StripAir", "Polar", "DynamicStall", "blade_element_momentum", "Induction",
        "Damping", "Viscoelastic", "MassDamping", "rayleigh", "PointMass", "Spring",
        "RootSpring", "Contact", "SelfContact", "Plane", "Sphere", "Cylinder", "Capsule", "Box")),
    "wind": ("Wind", "What blows: the `wind` of StripAir and the `flow` of Drag.", (
        "Wind", "Gust", "Turbulence", "WindTable")),
    "values": ("Values", "What may stand in place of a number.", (
        "Input", "PerInterval", "PerElement", "Along", "History", "Accelerogram",
        "SmoothHistory", "SmoothRotation")),
    "motion": ("Motion", "Simulations, steps, states and solutions.", (
        "simulate", "rollout", "rollout_jacobian", "Stepper", "rest", "State", "Solution",
        "Energy", "Stats", "ExplicitStepper", "SlowPathWarning", "save", "load", "export", "read",
        "view", "View")),
    "statics": ("Statics and stability", "Equilibria, paths of them, critical loads.", (
        "equilibrium", "path", "Path", "critical_load", "Critical")),
    "linear": ("Modes and linear models", "About an equilibrium, or a motion.", (
        "modes", "Modes", "modal_assurance", "pair_modes", "PairedModes", "campbell", "Campbell",
        "unbalance_response", "linearize", "Linear")),
    "accuracy": ("Accuracy", "Which mesh, element, method and step.", (
        "converge", "Convergence", "remesh", "advise", "Advice", "describe", "Description")),
    "identification": ("Identification", "Parameters and fields from measurements.", (
        "identify", "Parameter", "Measurement", "SlowBaseline", "SensorFrame", "pose_from_points",
        "Pose", "Fit", "identify_fields", "Smoothness", "FieldFit", "observe", "design", "Design",
        "compare", "Comparison")),
    "estimation": ("Estimation", "State and parameters while a structure moves.", (
        "KalmanFilter", "MovingHorizon", "Filtered")),
    "uncertainty": ("Uncertainty", "Scatter, sensitivities, rare events.", (
        "monte_carlo", "Samples", "Estimate", "monte_carlo_stream", "Stream", "sobol_indices",
        "SobolIndices", "tornado", "Tornado", "moment_derivatives", "MomentDerivatives",
        "rare_event", "RareEvent")),
    "block_rate": ("Block rate", "The index-reduced system and its rates.", (
        "block_rate", "BlockRate", "consistent_state", "MixedState")),
}
# Modules that are public whole: the title, the sentence, the module.
MODULES = {
    "sensors": ("Sensors", "What is read of a state, a solution or a mode.", "torchbeam.sensors"),
    "laws": ("Laws", "How parameters scatter.", "torchbeam.uncertainty.laws"),
    "plot": ("Pictures", "With matplotlib, the extra `plot`.", "torchbeam.plot"),
    "extend": ("Extending", "Own effects, sensors, environments.", "torchbeam.extend"),
    "envs": ("Environments", "Gymnasium's, and what own ones are made of.", "torchbeam_envs"),
    "functional": ("Episodes as values", "Begun and stepped by functions.",
                   "torchbeam_envs.functional"),
    "baselines": ("Baselines", "Controllers to compare with.", "torchbeam_envs.baselines"),
}
# What users call and read of a class, by its name; the rest of its members only the library asks.
# A class that is not named here shows all of its members; those of BARE pages show none: a scene
# takes their objects, and nobody calls them.
MEMBERS = {
    "Scene": ("to", "inputs", "batch_shape"),
    "Beam": ("straight", "curve", "arc", "from_nodes"),
    "Section": ("from_stiffness", "rectangle", "circle", "tube", "box", "i_beam", "channel",
                "angle", "polygon", "polygons", "laminate", "thin_walled",
                "from_cross_section", "rotated", "shifted"),
    "CrossSection": ("tube", "box", "i_beam", "channel", "angle", "polygon", "polygons",
                     "laminate", "thin_walled", "stiffness", "shear_centre", "elastic_centre",
                     "mass_centre", "stress"),
    "Material": (),
    "Body": (),
    "Support": (),
    "Stepper": ("rest", "jacobian", "engine"),
    "ExplicitStepper": ("rest",),
    "State": ("from_nodes", "at", "part", "node", "tip", "root", "reaction_of", "joint", "axes",
              "element_axes"),
    "Parameter": (),
    "Measurement": (),
    "Smoothness": (),
    "Fit": ("interval", "predict", "profile", "bootstrap", "refined", "summary", "save", "load"),
    "KalmanFilter": ("start", "run", "smooth"),
    "MovingHorizon": ("smooth",),
    "Filtered": ("unknown", "interval", "reading", "covariance", "unseen", "doubt"),
    "Path": (),
    "Linear": ("departure", "state_at", "discrete", "reduced", "response", "save", "load"),
    "MixedState": ("node",),
    "Stream": ("all", "error", "mean_interval", "quantile", "exceedance", "histogram"),
    "BatchSubset": ("gather", "scatter", "take", "put"),
    "LoadEffect": ("wrench", "tangent", "depends_on", "internal_states"),
    "NodeAcceleration": (),
    "Tendon": ("along",),
    "Viscoelastic": ("fractional",),
    "RandomField": ("captured",),
}
BARE = ("effects", "values", "laws")
# Where examples find public names, and how many examples an entry names.
MODULES_SEEN = ("tb", "tb.sensors", "tb.laws", "tb.plot", "torchbeam_envs", "baselines", "sensors")
SHOWN = 4
# The gallery: each example once.
GALLERY = {
    "Statics and stability": ("axes_and_signs", "spring", "lees_frame", "portal_frame",
                              "plastic_frame"),
    "Sections": ("composite_box", "blade_section"),
    "Vibration": ("campbell", "rotor", "ground_resonance", "read_blade"),
    "Air": ("flutter", "gust", "wind_turbine"),
    "Motion": ("creep", "four_bar", "converge", "block_rate_matrix"),
    "Contact and tendons": (
        "capstan", "crossing", "finger_grasp", "knot", "pulley", "rope_pile", "tendon_arm"),
    "Control": ("two_link", "parallel_robot", "mpc", "lqr", "mujoco_mast"),
    "Identification": (
        "identify", "identify_accelerometers", "identify_field", "identify_modes", "identify_wing",
        "identify_nuts", "identify_scipy"),
    "Estimation": ("changing_stiffness", "slewing_payload", "two_imus"),
    "Uncertainty": (
        "monte_carlo", "uncertainty_intervals", "uncertainty_sensitivity",
        "uncertainty_rare_event", "uncertainty_controller"),
}
# fmt: on


def entry(path: str, page: str) -> str:
    """What mkdocstrings reads for one name."""
    name = path.rpartition(".")[2]
    if name not in MEMBERS and page not in BARE:
        return f"::: {path}"
    members = list(MEMBERS.get(name, ()))
    return f"::: {path}\n    options:\n      members: {members}\n      inherited_members: {members}"


def place(module: str, name: str) -> str:
    """A function whose file is named after it is looked for in that file."""
    return f"{name}.{name}" if (ROOT / module.replace(".", "/") / f"{name}.py").exists() else name


def public(module: str) -> list[str]:
    """Names in `__all__` of a module, as its source says them."""
    own = module.replace("torchbeam_envs", "envs").replace(".", "/")
    file = next(path for path in (ROOT / f"{own}.py", ROOT / own / "__init__.py") if path.exists())
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return ast.literal_eval(node.value)
    raise ValueError(f"{file} says nothing in __all__")


@cache
def uses() -> dict[str, list[str]]:
    """Examples that use a public name, the shortest first: by `tb.name`, or `tb.module.name`."""
    found: dict[str, list[str]] = {}
    for path in sorted(EXAMPLES, key=lambda path: path.stat().st_size):
        used = {
            node.attr
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) in MODULES_SEEN
        }
        for name in used:
            found.setdefault(name, []).append(path.stem)
    return found


def used_in(name: str) -> str:
    """A line with links to examples."""
    links = [f"[{title_of(stem)}](../examples/{stem}.md)" for stem in uses().get(name, ())[:SHOWN]]
    return f"\n\n*In examples:* {', '.join(links)}" if links else ""


def reference() -> dict[str, str]:
    """Markdown of the pages, by their paths."""
    pages, rows, modules = {}, [], {module for *_, module in MODULES.values()}
    for key, (title, about, names) in REFERENCE.items():
        entries = "\n\n".join(entry(f"torchbeam.{name}", key) + used_in(name) for name in names)
        pages[f"reference/{key}.md"] = f"# {title}\n\n{about}\n\n{entries}\n"
        rows.append(f"| [{title}]({key}.md) | {about} |")
    for key, (title, about, module) in MODULES.items():
        entries = "\n\n".join(
            entry(f"{module}.{place(module, name)}", key) + used_in(name)
            for name in public(module)
            if not name.isupper() and f"{module}.{name}" not in modules
        )
        said = "tb.laws" if key == "laws" else module
        pages[f"reference/{key}.md"] = f"# {title}\n\n`{said}`. {about}\n\n{entries}\n"
        rows.append(f"| [{title}]({key}.md) | {about} |")
    lines = ast.get_docstring(ast.parse((ROOT / "torchbeam/__init__.py").read_text()))
    lines = lines.partition("\n\n")[2].replace(":\n\n", ":\n\n```python\n") + "\n```"
    about = f"# Reference\n\nSI units; leading axes of every tensor are batch axes.\n\n{lines}"
    return {"reference/index.md": "\n".join((about, "", "| | |", "|---|---|", *rows, ""))} | pages


def picture_of(name: str) -> str | None:
    """The picture of an example, seen from the examples' pages; None where it draws none."""
    for folder in ("figures", "figures/gallery"):
        if (ROOT / "docs" / folder / f"{name}.png").exists():
            return f"../{folder}/{name}.png"
    return None


def film_of(name: str, about: str) -> tuple[str, str] | None:
    """The film of an example, seen from the examples' pages, and what is seen in it, as the example
    says; None where it makes none.
    """
    if not (ROOT / f"docs/figures/gallery/{name}.gif").exists():
        return None
    seen = " ".join(about.partition("\nThe film: ")[2].partition("\n\n")[0].split())
    return f"../figures/gallery/{name}.gif", seen[:1].upper() + seen[1:]


def gallery() -> str:
    """Cards of all examples, by group: the film or the picture, what it is about, how long it
    takes.
    """
    taken = ROOT / "docs/results/gallery/gallery.json"
    seconds = json.loads(taken.read_text())["seconds"] if taken.exists() else {}
    lines = []
    for group, names in GALLERY.items():
        lines += [f"## {group}", "", '<div class="grid cards" markdown>', ""]
        for name in names:
            about = ast.get_docstring(ast.parse((ROOT / f"examples/{name}.py").read_text()))
            first = " ".join(about.partition("\n\n")[0].split())
            picture, seen = film_of(name, about) or (picture_of(name), "")
            lines.append(f"- [![{name}]({picture})]({name}.md)" if picture else "- ")
            after = f" {seen}" if seen else ""
            after += f" *{seconds[name]:.0f} s*" if name in seconds else ""
            lines += ["", f"    **[{title_of(name)}]({name}.md)** {first}{after}", ""]
        lines += ["</div>", ""]
    return "\n".join(lines)


@cache
def beside(name: str) -> Any:
    """A module beside this file, which no package holds."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# letters of titles as people write them
WRITTEN = {"Lees": "Lee's", "Mujoco": "MuJoCo", "carlo": "Carlo", "imus": "IMUs", "scipy": "SciPy"}


def title_of(name: str) -> str:
    """Of an example: letters as people write them."""
    title = name.replace("_", " ").capitalize()
    for word, written in WRITTEN.items():
        title = title.replace(word, written)
    return re.sub(r"\b(lqr|mpc|nuts)\b", lambda m: m.group().upper(), title, flags=re.I)


def examples() -> dict[str, str]:
    """A page of each: what it says of itself, its picture, its code."""
    pages = {}
    for path in EXAMPLES:
        text = path.read_text()
        about = ast.get_docstring(ast.parse(text)) or path.stem
        first, _, rest = about.partition("\n\n")
        code = text[text.index('"""', text.index('"""') + 3) + 3 :].strip()
        figure = picture_of(path.stem)
        picture = f"![{path.stem}]({figure})\n\n" if figure else ""
        film = film_of(path.stem, about)
        picture += f"![{film[1]}]({film[0]})\n\n" if film else ""
        pages[f"examples/{path.stem}.md"] = (
            f"# {title_of(path.stem)}\n\n{first}\n\n{picture}{rest}\n\n"
            f"`python examples/{path.name}`\n\n````python\n{code}\n````\n"
        )
    table = linked((ROOT / "examples" / "README.md").read_text(), "examples/index.md")
    for path in EXAMPLES:
        table = table.replace(f"| `{path.name}` |", f"| [`{path.name}`]({path.stem}.md) |")
    title, rest = table.split("\n\n", 1)
    seen = f"{title}\n\n{gallery()}\n## Checks and peers\n\n{rest}"
    return {"examples/index.md": seen} | pages


def environment_cards() -> str:
    """Cards of the environments: a film of the baseline, what the module says of the task, its
    reward by the specification, sizes, returns as `docs/env_cards.py` has stored them, and those of
    the study of learners.
    """
    taken = json.loads((ROOT / "docs/results/env_cards/env_cards.json").read_text())
    study = json.loads((ROOT / "docs/results/learning/results.json").read_text())
    lines = [
        "---\nhide: [toc]\n---\n",
        "# Tasks",
        "",
        "Each film is an episode under a controller without learning, and the first table has its "
        f"mean return over {taken['episodes']} held-out episodes. The second table is of the study "
        "of learners: coarser beams, other episodes, interquartile means. See "
        "[the specification](environments.md), [learners](learning.md) and "
        "[baselines](reference/baselines.md). `python docs/env_cards.py` makes films and numbers.",
        "",
        '<div class="grid cards" markdown>',
        "",
    ]
    for task, card in taken["cards"].items():
        name = re.sub(r"(Planar|Nest)?-v\d+$", "", task)
        file = re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()
        tree = ast.parse((ROOT / f"envs/{file}.py").read_text())
        about = " ".join(ast.get_docstring(tree).partition("\n\n")[0].split()).partition(": ")[2]
        returns = {name: mean for name, (mean, _) in card["returns"].items()}
        lines += [
            f"- ![{task}](figures/envs/{task}.gif)",
            "",
            f"    **`torchbeam/{task}`** {about[0].upper()}{about[1:]}",
            "",
            f"    {card['observation']} observations, {card['action']} actions, "
            f"{card['steps']} steps.",
            "",
            *(f"    {line}" for line in scores({"this task": returns})),
            "",
            *(f"    {line}" for line in learners(study, name)),
            '    ??? note "Reward"',
            *(f"        {line}" for line in ("```text", *reward(tree, name), "```")),
            "",
        ]
    return "\n".join((*lines, "</div>", "", sentence_of(taken), ""))


LEARNERS = {"lqr": "LQR", "lqg": "LQG", "ppo": "PPO", "sac": "SAC", "shac": "SHAC"}


def scores(columns: dict[str, dict[str, float]]) -> list[str]:
    """Lines of a table of returns: a column each, a row for every name in them."""
    lines = [f"| mean return | {' | '.join(columns)} |", "|---|" + "---:|" * len(columns)]
    for name in dict.fromkeys(name for column in columns.values() for name in column):
        cells = (f"{column[name]:.4g}" if name in column else "" for column in columns.values())
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return lines


def learners(study: dict, name: str) -> list[str]:
    """Interquartile means of returns in the study's tasks of this environment as a table, and an
    empty line; nothing where there are none.
    """
    columns = {}
    for task, made in study["tasks"].items():
        returns = {row["algorithm"]: row["return"] for row in study["rows"] if row["task"] == task}
        shown = {label: returns[key] for key, label in LEARNERS.items() if key in returns}
        if re.sub(r"(Planar|Nest)?-v\d+$", "", made["env"].partition("/")[2]) == name and shown:
            columns[f"`{task}`"] = shown
    return [*scores(columns), ""] if columns else []


def reward(tree: ast.Module, name: str) -> list[str]:
    """Lines of a task's specification about its reward."""
    of = next(n for n in tree.body if getattr(n, "name", "") == f"{name}VectorEnv")
    said = re.search(
        r"^## [^\n]*reward[^\n]*\n(.*?)(?=^## |\Z)", ast.get_docstring(of), re.M | re.S | re.I
    )
    return said[1].strip().splitlines()


def sentence_of(taken: dict) -> str:
    """Where and when numbers were made."""
    versions = ", ".join(f"{name} {own}" for name, own in taken["versions"].items())
    return f"Measured on: {taken['machine']}, Python {taken['python']}, {versions}."


def generated() -> dict[str, str]:
    return {
        "tasks.md": environment_cards(),
        "guide.md": (ROOT / "docs" / "README.md").read_text(),
        "changelog.md": (ROOT / "CHANGELOG.md").read_text(),
        **examples(),
        **reference(),
    }


HOMES = {"guide.md": "docs/README.md", "changelog.md": "CHANGELOG.md"}


def linked(text: str, page: str) -> str:
    """With links as the site has them: from the place of the file that a page is made of."""
    home = HOMES.get(page) or (
        page.replace("examples/index.md", "examples/README.md")
        if page.startswith("examples/")
        else f"docs/{page}"
    )

    def changed(match: re.Match) -> str:
        shown, link = match.groups()
        path, mark, anchor = link.partition("#")
        if not path or re.match(r"[a-z]+:", link):
            return match.group()
        path = posixpath.normpath(posixpath.join(posixpath.dirname(home), path))
        to = {own: new for new, own in HOMES.items()}.get(path)
        if to is None and path.startswith("docs/"):
            to = path[len("docs/") :]
        elif to is None and path == "examples/README.md":
            to = "examples/index.md"
        elif to is None and path in {f"examples/{example.name}" for example in EXAMPLES}:
            to = path[:-3] + ".md"
        if to is None:
            return shown if shown.startswith("`") else f"{shown} (`{path}`)"
        return f"]({posixpath.relpath(to, posixpath.dirname(page) or '.')}{mark}{anchor})".join(
            (f"[{shown}", "")
        )

    parts = re.split(r"(^```.*?^```$)", text, flags=re.M | re.S)  # code as it is
    return "".join(
        part if part.startswith("```") else re.sub(r"\[([^\]\[]*)\]\(([^)\s]+)\)", changed, part)
        for part in parts
    )


def typeset(text: str) -> str:
    """Formulas as MathML, which browsers draw by themselves: blocks ```math, and $...$ in a page
    that has some.
    """
    from latex2mathml.converter import convert

    def inline(formula: re.Match) -> str:
        return f"<span>{convert(formula[1])}</span>"  # a line that begins with <math> is a block

    block = re.compile(r"^```math\n(.*?)^```$", re.M | re.S)
    if not block.search(text):
        return text
    text = block.sub(
        lambda m: (
            f'<div class="formula">{convert(" ".join(m.group(1).split()), display="block")}</div>'
        ),
        text,
    )
    parts = re.split(r"(^```.*?^```$|`[^`\n]+`)", text, flags=re.M | re.S)
    return "".join(
        part if part.startswith("`") else re.sub(r"\$([^$\n]+)\$", inline, part) for part in parts
    )


def with_diagrams(text: str) -> str:
    """Blocks ```mermaid as the pictures that were drawn of them."""
    diagrams = beside("diagrams")

    def picture(match: re.Match) -> str:
        path = diagrams.picture_of(match[1]).relative_to(ROOT / "docs")
        return f"![diagram]({path}){{ .diagram }}"

    return diagrams.BLOCK.sub(picture, text)


def written(text: str, path: str) -> str:
    """A page as the site shows it: with its links, formulas, diagrams, and the way to its notebook
    where it is a tutorial.
    """
    if path in HOMES:
        return linked(text, path)
    if path.startswith(("examples/", "reference/")):
        return text
    text = typeset(with_diagrams(linked(text, path)))
    name = path.removesuffix(".md")
    if name not in beside("notebooks").TUTORIALS:
        return text
    title, rest = text.split("\n", 1)
    download = f"[:material-download: As a notebook](notebooks/{name}.ipynb){{ download }}"
    return f"{title}\n\n{download}\n{rest}"


def settings(pages: Iterable[str]) -> str:
    """Those of docs/site.toml, with the version in the bar at the top, and with the pages that are
    made in the navigation.
    """
    text = (ROOT / "docs/site.toml").read_text()
    version = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.M)[1]
    text = text.replace('site_name = "torchbeam"', f'site_name = "torchbeam {version}"')
    for title in ("Examples", "Reference"):
        paths = [path for path in pages if path.startswith(f"{title.lower()}/")]
        text = text.replace(f'"{title}" = []', f'"{title}" = {json.dumps(paths)}')
    return text


def main() -> None:
    """What the site is built of: out/pages, out/site.toml, and torchbeam_envs, whose folder has
    another name, where the reference looks for it.
    """
    folder = ROOT / "out" / "pages"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ROOT / "docs", folder, ignore=shutil.ignore_patterns(*LEFT_OUT))
    pages = {path.name: path.read_text() for path in (ROOT / "docs").glob("*.md")} | generated()
    del pages["README.md"]
    for path, text in pages.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(written(text, path))
    notebooks = beside("notebooks")
    (folder / "notebooks").mkdir()
    for name in notebooks.TUTORIALS:
        (folder / "notebooks" / f"{name}.ipynb").write_text(notebooks.written(name))
    (ROOT / "out" / "site.toml").write_text(settings(pages))
    PACKAGES.mkdir(exist_ok=True)
    if not (PACKAGES / "torchbeam_envs").exists():
        (PACKAGES / "torchbeam_envs").symlink_to(ROOT / "envs", target_is_directory=True)


if __name__ == "__main__":
    main()
