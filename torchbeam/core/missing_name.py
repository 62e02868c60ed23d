"""Names that a module, or a result, has not: the sentence that says which one does the same."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

ENVS = "torchbeam_envs"


def by_word(words: Mapping[str, str]) -> dict[str, str]:
    """Each word -> name, of name -> "word word"."""
    return {word: name for name, of in words.items() for word in of.split()}


# what torchbeam calls that which engineers and other programs call so, in small letters without _
ELSEWHERE = by_word(
    {
        "Beam": "cable chain cosseratrod element hose mesh mooringline node rod rope strip wire "
        "yarn",
        "Body": "rigidbody",
        "Contact": "collision floor ground hook obstacle ring seabed torus",
        "CrossSection": "crosssectionanalysis warping",
        "Cylinder": "drum pulley sheave tube",
        "Frame": "rotatingframe",
        "Hinge": "joint pinjoint revolute revolutejoint",
        "Input": "actuator control",
        "KalmanFilter": "ekf extendedkalmanfilter kalman observer",
        "LineLoad": "distributedforce distributedload udl uniformload",
        "MovingHorizon": "mhe movinghorizonestimator",
        "PointLoad": "force moment nodalforce nodalload pointforce torque",
        "PointMass": "lumpedmass mass payload tipmass",
        "RootMotion": "baseexcitation basemotion",
        "Section": "crossection profile",
        "Slider": "prismatic prismaticjoint",
        "Stepper": "integrator step",
        "StripAir": "aerodynamics airfoil aerofoil lift wing",
        "Support": "anchor bc boundary boundarycondition clamp clamped constraint encastre fixed "
        "grasp grip gripper pin pinned roller simplesupport",
        "Tendon": "actuationcable cabletendon string",
        "Weld": "fixedjoint rigidjoint",
        "campbell": "campbelldiagram rotor whirl",
        "critical_load": "buckle buckling bucklingload eulerload",
        "equilibrium": "catenary drape hang relax solve solvestatic static staticsolve",
        "identify": "calibrate curvefit fit leastsquares parameterestimation",
        "laws": "distribution distributions lognormal normal uniform",
        "linearize": "linearise lti statespace transferfunction",
        "modes": "eigenfrequencies eigenmodes eigenvalues frequencies modal modalanalysis "
        "naturalfrequencies",
        "monte_carlo": "mc montecarlosimulation sample sampling",
        "path": "arclength continuation loadpath riks",
        "plot": "animate diagram draw figure show",
        "rare_event": "failureprobability form reliability subsetsimulation",
        "rayleigh": "rayleighdamping",
        "simulate": "dynamic integrate run simulation simulator solveivp timehistory transient",
        "sobol_indices": "sensitivities sensitivity sobol",
        "unbalance_response": "imbalance imbalanceresponse synchronousresponse unbalance",
        "view": "render viewer",
        ENVS: "env environment environments gym make",
        f"{ENVS}.baselines": "lqg lqr mpc pd pid",
    }
)


def missing(
    owner: str, name: str, known: Iterable[str], elsewhere: Mapping[str, str] | None = None
) -> AttributeError:
    """The error for a name that a module, or an object of a class, has not, with what is near among
    those `known`, or does the same by `elsewhere`.
    """
    text = f"{owner} has no attribute {name!r}"
    if not name.startswith("_"):
        from difflib import get_close_matches

        plain = {other.lower().replace("_", ""): other for other in known}
        word = name.lower().replace("_", "")
        table = elsewhere or {}
        same = table.get(word) or table.get(word.removesuffix("s"))
        near = [same] if same else [plain[x] for x in get_close_matches(word, plain, 3, 0.75)]
        text += f"; {', '.join(near)} {'are' if len(near) > 1 else 'is'} near" if near else ""
    return AttributeError(text, name=name)


def near_names(module: dict[str, Any], elsewhere: Mapping[str, str]) -> None:
    """For `globals()` of a module with `__all__`: a name that it has not raises `missing`. Type
    checkers, which do not see it, go on telling misspelt names.
    """

    def of_module(name: str) -> Any:
        raise missing(f"module {module['__name__']!r}", name, module["__all__"], elsewhere)

    module["__getattr__"] = of_module


class Named:
    """Base of results that say which attribute does what another name stands for elsewhere."""

    _elsewhere: ClassVar[Mapping[str, str]] = {}

    if not TYPE_CHECKING:  # or every attribute would count as there

        def __getattr__(self, name: str) -> Any:
            known = [x for x in {*dir(type(self)), *vars(self)} if not x.startswith("_")]
            raise missing(f"{type(self).__name__!r} object", name, known, self._elsewhere)
