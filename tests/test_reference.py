"""The package against the float64 reference: re-seeded every step to 1e-9, free-running in float32 for a while."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax.agents import cacla, icac
from icac_jax.agents.base import Transition
from icac_jax.agents.cacla import CaclaHyper, CaclaSpec
from icac_jax.agents.curious import CuriousState
from icac_jax.curiosity import itm
from icac_jax.precision import as_given
from tests.reference.learner import Learner, Map
from tests.reference.slots import Slots, cacla_arrays, curiosity_arrays, flatten, unflatten

CAPACITY = 64
REPEATS = {"cacla": cacla.once, "cacla_var": cacla.by_variance, "icac": cacla.by_variance}


def stack(states):
    return jax.tree.map(lambda *leaves: np.stack(leaves), *states)


@pytest.mark.parametrize(
    ("size", "e_max", "epsilon", "stimuli"),
    [
        (2, 0.45, 1e-4, 20_000),
        (4, 0.9, 1e-4, 20_000),
        (2, 0.45, 0.3, 40_000),
        pytest.param(2, 0.45, 1e-4, 100_000, marks=pytest.mark.slow),
        pytest.param(4, 0.9, 1e-4, 100_000, marks=pytest.mark.slow),
    ],
    ids=["2-D", "4-D", "2-D trajectory", "2-D long", "4-D long"],
)
def test_map_agrees_with_twin(size, e_max, epsilon, stimuli):
    rng = np.random.default_rng(size)
    reference = Map(rng.uniform(-1, 1, size), rng.uniform(-1, 1, size), e_max, epsilon)
    slots = Slots(CAPACITY)
    with jax.enable_x64(True), as_given():
        step = jax.jit(jax.vmap(functools.partial(itm.update, rate=epsilon, e_max=e_max)))
        for _ in range(stimuli // 2000):
            points = rng.uniform(-1, 1, (2000, size))
            if epsilon > 0.1:  # a walk that drags its winner along takes the rare branches as well
                walk = np.sin(np.cumsum(0.1 * rng.normal(size=(2000, size)), axis=0))
                points = np.where(rng.uniform(size=(2000, 1)) < 0.1, points, walk)
            states = [slots.map_arrays(reference.nodes, size)]
            distances, winners = [], []
            for point in points:
                before = slots.of
                n, distance, _, _ = reference.adapt(point)
                winners.append(before[n])
                distances.append(distance)
                slots.follow(reference.nodes, reference.pruned)
                states.append(slots.map_arrays(reference.nodes, size))
            wanted = stack(states[1:])
            got, info = jax.device_get(step(stack(states[:-1]), points))
            np.testing.assert_array_equal(got.live, wanted.live)
            np.testing.assert_array_equal(got.adjacency, wanted.adjacency)
            np.testing.assert_array_equal(got.degree, wanted.degree)
            np.testing.assert_allclose(got.weights[got.live], wanted.weights[wanted.live], rtol=0, atol=1e-9)
            np.testing.assert_array_equal(info.nearest, winners)
            np.testing.assert_allclose(info.distance, distances, rtol=0, atol=1e-9)
    assert reference.events["cut"] > 10
    assert reference.events["born"] > 10
    if epsilon > 0.1:
        assert reference.events["too close"] > 10
        assert reference.events["pruned"] > 10


class Reacher:
    """A 2-DoF reaching task in normalised units, just enough to make realistic transitions."""

    def __init__(self, rng):
        self.rng = rng
        self.reset()

    def reset(self):
        self.joints = self.rng.uniform(-1, 1, 2)
        self.goal = self.tip(self.rng.uniform(-1, 1, 2))

    @staticmethod
    def tip(joints):
        a, b = (joints + 1) * np.pi / 2
        return np.array([np.cos(a) + np.cos(a + b), np.sin(a) + np.sin(a + b)]) / 2

    def observe(self):
        return np.concatenate([self.joints, self.goal])

    def step(self, action):
        obs = self.observe()
        self.joints = np.clip(self.joints + action / 9, -1, 1)
        reached = np.linalg.norm(self.tip(self.joints) - self.goal) < 0.15
        after = self.observe()
        if reached or self.rng.uniform() < 0.02:
            self.reset()
        return obs, 50.0 * reached, after


def twin_learner(algo, rng, capacity=CAPACITY):
    spec = icac.Spec(map_capacity=capacity) if algo == "icac" else CaclaSpec()
    sizes = (4, 12, 2), (4, 12, 1), (4, 12, 2)
    counts = [sum((a + 1) * b for a, b in itertools.pairwise(s)) for s in sizes]
    actor, critic = (unflatten(rng.uniform(-0.3, 0.3, n), s, False) for n, s in zip(counts[:2], sizes[:2], strict=True))
    fresh = rng.uniform(-0.3, 0.3, (capacity, counts[2]))
    world = None
    if algo == "icac":
        world = Map(rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2), 0.3, 0.01)
        for name in world.nodes:
            world.nodes[name].predictor = unflatten(fresh[name], sizes[2], True)
    learner = Learner(
        algo,
        actor,
        critic,
        world,
        gamma=0.9,
        actor_rate=0.01,
        critic_rate=0.01,
        predictor_rate=0.01,
        beta=0.01,
        mu=40,
        lag=20,
    )
    hyper = icac.Hyper(e_max=0.3, map_rate=0.01) if algo == "icac" else CaclaHyper()
    return spec, hyper, learner, fresh, sizes[2]


class Recorder:
    """Runs the reference and keeps, for each step, the state before it, the transition and what came out."""

    def __init__(self, algo, seed):
        self.rng = np.random.default_rng(seed)
        self.spec, self.hyper, self.learner, self.fresh, self.sizes = twin_learner(algo, self.rng)
        self.repeats = REPEATS[algo]
        self.agent = icac.agent(self.spec) if algo == "icac" else cacla.agent(self.spec, self.repeats)
        self.slots = Slots(CAPACITY)
        self.world = Reacher(self.rng)
        self.steps = 0

    def arrays(self):
        if self.learner.map is None:
            return cacla_arrays(self.learner)
        curious = curiosity_arrays(self.learner, self.slots, self.fresh, self.spec.window, 2, self.steps)
        return CuriousState(agent=cacla_arrays(self.learner), curiosity=curious)

    def update(self, state, transition):
        """The learner after a transition, what it reports, and what the actor-critic inside it did."""
        hyper = self.hyper.traced()
        new, report = self.agent.update(state, transition, jax.random.key(0), hyper, jnp.array(True))
        seen, action, reward, after, terminated = transition[:5]
        total = hyper.reward_scale * reward + report.sums.get("intrinsic_reward", 0.0)
        inside = actor_critic(state)
        info = cacla.update(self.spec, inside, seen, action, total, after, terminated, hyper, repeats=self.repeats)[1]
        return new, report, info

    def born(self, _name):
        slot = self.slots.for_birth(self.learner.map.pruned)
        return unflatten(self.fresh[slot], self.sizes, True)

    def step(self):
        mean = self.learner.actor(self.world.observe())
        action = np.clip(mean + 0.5 * self.rng.normal(size=2), -1, 1)
        obs, reward, after = self.world.step(action)
        outcome = self.learner.learn(obs, action, reward, after, 2, self.born)
        if self.learner.map is not None:
            self.slots.follow(self.learner.map.nodes, self.learner.map.pruned)
        self.steps += 1
        reached = np.bool_(reward > 0)
        return Transition(obs, action, np.float64(reward), after, reached, np.bool_(False), np.float64(0)), outcome


def actor_critic(state):
    return state.agent if isinstance(state, CuriousState) else state


def same_learner(got, wanted, tolerance):
    for leaf, other in zip(*map(jax.tree.leaves, map(actor_critic, (got, wanted))), strict=True):
        np.testing.assert_allclose(leaf, other, rtol=tolerance, atol=tolerance)
    if not isinstance(got, CuriousState):
        return
    live = wanted.curiosity.map.live
    np.testing.assert_array_equal(got.curiosity.map.live, live)
    np.testing.assert_array_equal(got.curiosity.map.adjacency, wanted.curiosity.map.adjacency)
    for name in ("params", "errors", "queries"):
        mine, theirs = getattr(got.curiosity.bank, name), getattr(wanted.curiosity.bank, name)
        if name == "errors":  # a slot used before still holds its former node's errors beyond the count
            held = np.arange(mine.shape[-1]) < wanted.curiosity.bank.queries[..., None]
            mine, theirs = mine * held, theirs * held
        np.testing.assert_allclose(mine[live], theirs[live], rtol=tolerance, atol=tolerance)


LEARNERS = [
    ("icac", 5_000),
    ("cacla_var", 20_000),
    ("cacla", 4_000),
    pytest.param("icac", 20_000, marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("algo", "steps"), LEARNERS)
def test_learner_agrees_with_twin(algo, steps):
    run = Recorder(algo, 5)
    births = repeated = 0
    with jax.enable_x64(True), as_given():
        update = jax.jit(jax.vmap(run.update))
        for _ in range(steps // 1000):
            states, transitions, outcomes = [run.arrays()], [], []
            for _ in range(1000):
                transition, outcome = run.step()
                transitions.append(transition)
                outcomes.append(outcome)
                states.append(run.arrays())
            got, report, info = jax.device_get(update(stack(states[:-1]), stack(transitions)))
            same_learner(got, stack(states[1:]), 1e-9)
            delta, times, progress, perception = map(np.array, zip(*outcomes, strict=True))
            np.testing.assert_allclose(info.td_error, delta, rtol=1e-9, atol=1e-9)
            np.testing.assert_array_equal(info.actor_updates, times)
            assert bool(report.sums) == (algo == "icac")
            for name, terms in (("learning_progress", progress), ("perception_error", perception)):
                np.testing.assert_allclose(report.sums.get(name, np.zeros(1000)), terms, rtol=0, atol=1e-9)
            assert report.finite.all()
            repeated += int(np.sum(times > 1))
    if algo == "icac":
        births = run.learner.map.events["born"]
        assert births > 5
    if algo != "cacla":
        assert repeated > 50


@pytest.mark.parametrize("algo", ["icac", "cacla_var", "cacla"])
def test_float32_stays_close_when_running_freely(algo):
    run = Recorder(algo, 11)
    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32) if leaf.dtype == float else leaf, run.arrays())
    transitions, states = [], []
    for _ in range(400):
        transitions.append(run.step()[0])
        states.append(flatten(run.learner.actor))
    batch = jax.tree.map(
        lambda *leaves: jnp.asarray(np.stack(leaves), jnp.float32 if leaves[0].dtype == float else bool), *transitions
    )

    def body(state, transition):
        state, _, _ = run.update(state, transition)
        return state, actor_critic(state).actor

    end, actors = jax.jit(lambda start: jax.lax.scan(body, start, batch))(start)
    np.testing.assert_allclose(actors, np.array(states), rtol=0, atol=2e-4)
    np.testing.assert_allclose(actor_critic(end).critic, flatten(run.learner.critic), rtol=0, atol=2e-3)
    if algo == "icac":
        np.testing.assert_array_equal(end.curiosity.map.live, run.arrays().curiosity.map.live)
