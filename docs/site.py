"""Pages of the site that are made of other files, for mkdocs (`make docs`): the home page of
README.md, the guide of docs/README.md, a page of each example, the reference of all public names,
the changelog. Links out of docs/ go to those pages; what the site does not show is named without a
link.
"""

import ast
import json
import posixpath
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = ROOT / "out" / "packages"
EXAMPLES = sorted(path for path in (ROOT / "examples").glob("*.py"))

# What is public, by what it is for: title of a page, first sentence, names of `torchbeam`.
# fmt: off
REFERENCE = {
    "scene": ("Scenes", "What there is: beams, bodies, sections, and what holds and joins them.", (
        "Scene", "Beam", "Section", "Stations", "Table", "Body", "Support", "Frame", "RootMotion",
        "Weld", "Ball", "Hinge", "Universal", "Slider", "Cylindrical", "Distance")),
    "effects": ("Effects", "What acts: only what a scene names exists.", (
        "Gravity", "TipLoad", "PointLoad", "LineLoad", "Load", "Actuation", "Tendon", "Drag",
        "Damping", "MassDamping", "rayleigh", "PointMass", "Spring", "RootSpring", "Contact",
        "SelfContact", "Plane", "Sphere", "Cylinder", "Capsule", "Box")),
    "values": ("Values", "What may stand in place of a number.", (
        "Input", "PerInterval", "PerElement", "Along", "History", "Accelerogram")),
    "motion": ("Motion", "Simulations, steps, states and solutions.", (
        "simulate", "rollout", "Stepper", "rest", "State", "Solution", "Energy", "Stats",
        "ExplicitStepper", "SlowPathWarning", "export")),
    "statics": ("Statics and stability", "Equilibria, paths of them, critical loads.", (
        "equilibrium", "path", "Path", "critical_load", "Critical")),
    "linear": ("Modes and linear models", "About an equilibrium, or a motion.", (
        "modes", "Modes", "modal_assurance", "pair_modes", "PairedModes", "linearize", "Linear")),
    "accuracy": ("Accuracy", "Which mesh, element, method and step.", (
        "converge", "Convergence", "remesh", "advise", "Advice", "describe", "Description")),
    "identification": ("Identification", "Parameters and fields from measurements.", (
        "identify", "Parameter", "Measurement", "Fit", "identify_fields", "Smoothness",
        "FieldFit", "observe")),
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
    "laws": ("Laws", "How parameters scatter.", "torchbeam.analysis.uncertainty.laws"),
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
    "Section": ("from_stiffness", "rectangle", "circle", "rotated", "shifted"),
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
    "Path": (),
    "Linear": ("departure", "state_at", "discrete", "reduced", "response"),
    "MixedState": ("node",),
    "Stream": ("all", "error", "mean_interval", "quantile", "exceedance", "histogram"),
    "BatchSubset": ("gather", "scatter", "take", "put"),
    "LoadEffect": ("wrench", "tangent", "depends_on", "internal_states"),
    "NodeAcceleration": (),
    "Tendon": ("along",),
    "RandomField": ("captured",),
}
BARE = ("effects", "values", "laws")
# The gallery: each example once.
GALLERY = {
    "Statics and stability": ("axes_and_signs", "spring", "lees_frame", "portal_frame"),
    "Vibration": ("campbell", "rotor"),
    "Motion": ("four_bar", "converge", "block_rate_matrix"),
    "Contact and tendons": ("capstan", "crossing", "knot", "tendon_arm"),
    "Control": ("two_link", "parallel_robot", "mpc", "lqr"),
    "Identification": (
        "identify", "identify_accelerometers", "identify_field", "identify_modes", "identify_wing",
        "identify_nuts", "identify_scipy"),
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
    return f"::: {path}\n    options:\n      members: {list(MEMBERS.get(name, ()))}"


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


def reference() -> dict[str, str]:
    """Markdown of the pages, by their paths."""
    pages, rows, modules = {}, [], {module for *_, module in MODULES.values()}
    for key, (title, about, names) in REFERENCE.items():
        entries = "\n\n".join(entry(f"torchbeam.{name}", key) for name in names)
        pages[f"reference/{key}.md"] = f"# {title}\n\n{about}\n\n{entries}\n"
        rows.append(f"| [{title}]({key}.md) | {about} |")
    for key, (title, about, module) in MODULES.items():
        entries = "\n\n".join(
            entry(f"{module}.{place(module, name)}", key)
            for name in public(module)
            if not name.isupper() and f"{module}.{name}" not in modules
        )
        said = "tb.laws" if key == "laws" else module
        pages[f"reference/{key}.md"] = f"# {title}\n\n`{said}`. {about}\n\n{entries}\n"
        rows.append(f"| [{title}]({key}.md) | {about} |")
    about = "# Reference\n\nSI units; leading axes of every tensor are batch axes."
    return {"reference/index.md": "\n".join((about, "", "| | |", "|---|---|", *rows, ""))} | pages


def picture_of(name: str) -> str | None:
    """The picture of an example, seen from the examples' pages; None where it draws none."""
    for folder in ("figures", "figures/gallery"):
        if (ROOT / "docs" / folder / f"{name}.png").exists():
            return f"../{folder}/{name}.png"
    return None


def gallery() -> str:
    """Cards of all examples, by group: the picture, what it is about, how long it takes."""
    taken = ROOT / "docs/results/gallery/gallery.json"
    seconds = json.loads(taken.read_text())["seconds"] if taken.exists() else {}
    lines = []
    for group, names in GALLERY.items():
        lines += [f"## {group}", "", '<div class="grid cards" markdown>', ""]
        for name in names:
            about = ast.get_docstring(ast.parse((ROOT / f"examples/{name}.py").read_text()))
            first = " ".join(about.partition("\n\n")[0].split())
            picture = picture_of(name)
            lines.append(f"- [![{name}]({picture})]({name}.md)" if picture else "- ")
            after = f" *{seconds[name]:.0f} s*" if name in seconds else ""
            lines += ["", f"    **[{title_of(name)}]({name}.md)** {first}{after}", ""]
        lines += ["</div>", ""]
    return "\n".join(lines)


def title_of(name: str) -> str:
    return name.replace("_", " ").capitalize()


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


def generated() -> dict[str, str]:
    return {
        "index.md": "---\nhide: [navigation]\n---\n\n" + (ROOT / "README.md").read_text(),
        "guide.md": (ROOT / "docs" / "README.md").read_text(),
        "changelog.md": (ROOT / "CHANGELOG.md").read_text(),
        **examples(),
        **reference(),
    }


HOMES = {"index.md": "README.md", "guide.md": "docs/README.md", "changelog.md": "CHANGELOG.md"}


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


def on_startup(command, dirty):
    """mkdocs: torchbeam_envs, whose folder has another name, where the reference looks for it."""
    PACKAGES.mkdir(parents=True, exist_ok=True)
    if not (PACKAGES / "torchbeam_envs").exists():
        (PACKAGES / "torchbeam_envs").symlink_to(ROOT / "envs", target_is_directory=True)


def on_config(config):
    """mkdocs: the navigation, with the pages that are made."""
    pages = generated()
    for title in ("Examples", "Reference"):
        entry = next(entry for entry in config.nav if title in entry)
        entry[title] = [path for path in pages if path.startswith(f"{title.lower()}/")]
    return config


def on_files(files, config):
    """mkdocs: the pages above beside those of docs/."""
    from mkdocs.structure.files import File

    old = files.get_file_from_path("README.md")
    if old is not None:
        files.remove(old)
    for path, text in generated().items():
        content = linked(text, path) if path in HOMES else text
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown, page, config, files):
    """mkdocs: links of pages of docs/."""
    made = page.file.src_uri in HOMES or page.file.src_uri.startswith(("examples/", "reference/"))
    return markdown if made else linked(markdown, page.file.src_uri)
