"""Good calls of what results, pictures and environments offer: as `public_calls`, and one table
with it.
"""

from pathlib import Path

import numpy as np
import torch
import torchbeam_envs as envs
from torchbeam_envs import baselines, functional

import torchbeam as tb
from tests.cases.public_calls import (
    BEAM,
    CALLS,
    DATA,
    DRIVEN,
    EQUILIBRIUM,
    FOLDER,
    FORCE,
    HINGED,
    LEANING,
    LINEAR,
    PLAN,
    SCENE,
    START,
    STEPPER,
    model,
)  # fmt: skip

S, HERE = tb.sensors, Path(FOLDER.name)
READ = tb.Measurement(DATA + 0.01 * DATA.new_tensor([1.0, -1.0, 1.0]), 0.1)
FIT = tb.identify(model, READ, {"f": 0.5})
LAWS = {"f": tb.laws.Normal(1.0, 0.1), "g": tb.laws.Normal(1.0, 0.1)}
SAMPLES = tb.monte_carlo(lambda x: x[..., 0], LAWS, 64, replicates=4)
CURVES = tb.monte_carlo(lambda x: x[:, :1] * torch.linspace(0, 1, 8, dtype=x.dtype), LAWS, 64)
STREAM = tb.monte_carlo_stream(lambda x: x[..., 0], LAWS, 64)
TORNADO = tb.tornado(lambda x: x[..., 0], LAWS)
FIELD_DATA = tb.Measurement(torch.linspace(1, 2, 6, dtype=DATA.dtype), 0.1)
FIELD = dict(
    model=lambda theta: theta["x"],
    data=FIELD_DATA,
    start={"x": torch.ones(6)},
    smoothness={"x": tb.Smoothness()},
)
FIELD_FIT = tb.identify_fields(**FIELD)
PATH = tb.path(SCENE, 0.3, step=0.3)
PULLED = tb.Scene(BEAM, [tb.Tendon([(0, FORCE), (-1, FORCE)], tension=1.0)])
AX = tb.plot.axes()
TINY = dict(elements=2, planar=True, engine="eager", params_in_info=False)
ENV, ONE = envs.TipReachVectorEnv(2, **TINY), envs.TipReachEnv(**TINY)
SIMULATION = functional.simulation(envs.TipReachVectorEnv, 2, **TINY)
NOW = functional.reset(SIMULATION, seed=0)
GOAL = dict(reset_mask=np.array([True, True]), params={}, goal=[1.4, 0.0, 0.1])


def stepped(actions):
    ENV.reset(seed=0)
    return ENV.step(actions)


def one_stepped(action):
    ONE.reset(seed=0)
    return ONE.step(action)


LEVEL = dict(level=0.9)
# fmt: off
OF_RESULTS = {
    "fit.interval": (FIT.interval, dict(**LEVEL, method="laplace", repeats=20, seed=0)),
    "fit.bootstrap": (FIT.bootstrap, dict(repeats=20, seed=0)),
    "fit.profile": (lambda name, level: FIT.profile(name, level=level), dict(name="f", **LEVEL)),
    "fit.predict": (FIT.predict, dict(model=model, sensor=None, times=None, **LEVEL, sigma=None,
                                      experiment=None)),
    "fit.refined": (FIT.refined, dict(model=model)),
    "fit.save": (FIT.save, dict(path=str(HERE / "fit.pt"))),
    "fit.summary": (FIT.summary, LEVEL),
    "fit[]": (lambda name: FIT[name], dict(name="f")),
    "identify_fields": (tb.identify_fields, FIELD),
    "plan.report": (tb.design(**PLAN).report, dict(path=str(HERE / "plan.html"))),
    "field.interval": (FIELD_FIT.interval, dict(name="x", **LEVEL)),
    "field.deviation": (FIELD_FIT.deviation, dict(name="x")),
    "samples.bands": (SAMPLES.bands, dict(**LEVEL, interval=0.95)),
    "samples.convergence": (SAMPLES.convergence, dict(reference=1.0)),
    "samples.deviation": (SAMPLES.deviation_interval, LEVEL),
    "samples.exceedance": (SAMPLES.exceedance, dict(x=1.0, interval=0.9, failed_exceed=None)),
    "samples.mean": (SAMPLES.mean_interval, LEVEL),
    "samples.quantile": (SAMPLES.quantile, dict(levels=[0.1, 0.5], interval=None)),
    "samples.summary": (SAMPLES.summary, dict(levels=(0.1, 0.5), interval=0.9, thresholds=(1.0,))),
    "stream.exceedance": (STREAM.exceedance, dict(x=1.0, interval=0.9)),
    "stream.histogram": (STREAM.histogram, dict(edges=[0.5, 1.0, 1.5])),
    "stream.quantile": (STREAM.quantile, dict(levels=[0.1, 0.5], interval=0.9)),
    "state.at": (START.at, dict(t=1.0)),
    "state.broadcast": (START.broadcast, dict(shape=(2,))),
    "state.part": (HINGED.part, dict(name="arm")),
    "state.reaction_of": (EQUILIBRIUM.reaction_of, dict(support=0)),
    "state.row": (START.row, dict(index=0)),
    "State.stack": (tb.State.stack, dict(states=[START, START])),
    "scene.to": (SCENE.to, dict(dtype=torch.float64)),
    "stepper.jacobian": (STEPPER.jacobian, dict(state=tb.rest(DRIVEN), u={"u": FORCE},
                                                model=LINEAR, dt=0.1)),
    "linear.discrete": (LINEAR.discrete, dict(dt=0.1)),
    "linear.reduced": (LINEAR.reduced, dict(count=2, static=False)),
    "linear.save": (LINEAR.save, dict(path=str(HERE / "model.npz"))),
    "linear.slopes": (LINEAR.slopes, dict(state=tb.rest(DRIVEN))),
    "laws.Constant": (tb.laws.Constant, dict(value=1.0)),
    "laws.Empirical": (tb.laws.Empirical, dict(values=[1.0, 2.0, 3.0], weights=[1.0, 1.0, 2.0])),
    "laws.Gumbel": (tb.laws.Gumbel, dict(location=1.0, scale=1.0)),
    "laws.LogNormal": (tb.laws.LogNormal, dict(mean=1.0, deviation=1.0)),
    "laws.RandomField": (tb.laws.RandomField, dict(
        s=[0.0, 0.5, 1.0], mean=1.0, deviation=0.1, correlation_length=0.3, kernel="exponential",
        marginal="lognormal", terms=2)),
    "laws.Triangular": (tb.laws.Triangular, dict(least=0.0, mode=1.0, largest=2.0)),
    "laws.Truncated": (tb.laws.Truncated, dict(law=LAWS["f"], least=-1.0, largest=1.0)),
    "laws.Uniform": (tb.laws.Uniform, dict(least=0.0, largest=1.0)),
    "laws.Weibull": (tb.laws.Weibull, dict(scale=1.0, shape=2.0)),
    "plot.bands": (tb.plot.bands, dict(t=torch.linspace(0, 1, 8), samples=CURVES, **LEVEL,
                                       interval=0.95, label=None)),
    "plot.campbell": (tb.plot.campbell, dict(speed=torch.linspace(0, 1, 4), orders=(1, 2),
                                             frequency=torch.ones(4, 2), names=("a", "b"),
                                             unit="rpm")),
    "plot.convergence": (tb.plot.convergence, dict(runs={"a": SAMPLES}, reference=1.0)),
    "plot.correlation": (tb.plot.correlation, dict(fit=FIT)),
    "plot.cross_section": (tb.plot.cross_section, dict(
        cross=tb.CrossSection.tube(0.1, 0.05, 1.0, 0.3, 1.0), show="11", F=(0.0, 0, 1.0),
        M=(0.0, 0, 1.0), axes="section")),
    "plot.design": (tb.plot.design, dict(plan=tb.design(**PLAN))),
    "plot.fit": (tb.plot.fit, dict(fit=FIT)),
    "plot.grid": (tb.plot.grid, dict(rows=1, columns=2, size=None, three=())),
    "plot.load_path": (tb.plot.load_path, dict(path=PATH, sensor=S.TipPosition()["z"],
                                               label=None)),
    "plot.obstacles": (tb.plot.obstacles, dict(scene=LEANING, ax=AX, plane="xz", state=None)),
    "plot.tendons": (tb.plot.tendons, dict(scene=PULLED, state=START, ax=AX, plane="xz",
                                           label=None)),
    "plot.tornado": (tb.plot.tornado, dict(table=TORNADO)),
    "plot.profile": (tb.plot.profile, dict(profile=FIT.profile("f")[0])),
    **{name: (getattr(envs, f"{name}Env"), {**TINY, **more}) for name, more in {
        "TipReach": dict(max_episode_steps=10, length=1.5, section="aluminium strip", up=None,
                         direction=(1.0, 0, 0), damping=1e-3, gravity=(0, 0, -9.81), delay=1,
                         force=(1.2, 2.0), control_interval=0.02, substeps=2, form="nodal",
                         method="midpoint", solver=None, dtype=None, sensors=("tip", "middle"),
                         noise=0.0, frames=1, randomize=None, control_cost=1e-3, reach=0.8,
                         failure_reward=None, render_mode=None),
        "TipTrack": {}, "FlutterHold": {}, "Slew": {}, "Payload": {}, "TwoLink": {},
        "FollowTarget": dict(elements=5),
        "ReachObstacles": dict(elements=5), "Peg": {}, "Gripper": dict(elements=4)}.items()},
    "env.reset": (ENV.reset, dict(seed=[0, 1], options=GOAL)),
    "env.step": (stepped, dict(actions=np.zeros((2, 1)))),
    "single.reset": (ONE.reset, dict(seed=0, options={})),
    "single.step": (one_stepped, dict(action=np.zeros(1))),
    "Actuator": (envs.Actuator, dict(effect=tb.TipLoad(force=tb.Input("u", 3)),
                                     gain=torch.eye(3).double(), bias=(0.0, 0, 1.0))),
    "TipForce": (envs.TipForce, dict(gain=[[0.0, 1.0, 0.0]], follower=False)),
    "Observed": (envs.Observed, dict(sensor=S.TipPosition(), scale=1.0, high=10.0)),
    "envs.Parameter": (envs.Parameter, dict(value=1.0, low=0.5, high=2.0, least=0.0, above=False)),
    "functional.reset": (functional.reset, dict(sim=SIMULATION, seed=0, params=None, goal=None)),
    "functional.step": (functional.step, dict(sim=SIMULATION, episodes=NOW,
                                              action=torch.zeros(2, 1))),
    "PD": (baselines.PD, dict(env=ENV, gains=[1.0, 0.1])),
    "MPC": (baselines.MPC, dict(env=ENV, horizon=3, iterations=1, terminal=5.0, damping=1e-6,
                                informed=False)),
}
# fmt: on
EVERY = {**CALLS, **OF_RESULTS}
