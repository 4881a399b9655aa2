"""Settings: presets, resolution, and one clear line for each kind of wrong value."""

import dataclasses
import math
import tomllib

import jax
import jax.numpy as jnp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from icac_jax import icac
from icac_jax.agents import registry
from icac_jax.agents.cacla import CaclaHyper, CaclaSpec
from icac_jax.agents.icac import Hyper, Spec
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError
from icac_jax.runs import folder
from icac_jax.settings.options import (
    UNSAID,
    all_options,
    applies,
    defaults,
    of_learner,
    options_of,
    resolve,
)
from icac_jax.settings.run_options import RunOptions


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"gama": 0.9}, "gama: no such option; did you mean gamma?"),
        ({"zzz": 1}, "zzz: no such option"),
        ({"actor_rate": -0.1}, "actor_rate: must be a number greater than 0, got -0.1"),
        ({"critic_rate": 0.0}, "critic_rate: must be a number greater than 0, got 0.0"),
        ({"horizon": 0}, "horizon: must be a whole number at least 1 and at most 1000000, got 0"),
        ({"horizon": 2.5}, "horizon: must be a whole number at least 1 and at most 1000000, got 2.5"),
        ({"e_max": 0.0}, "e_max: must be a number greater than 0, got 0.0"),
        ({"e_max": math.inf}, "e_max: must be a number greater than 0, got inf"),
        ({"gamma": math.nan}, "gamma: must be a number at least 0 and less than 1, got nan"),
        ({"gamma": 1.0}, "gamma: must be a number at least 0 and less than 1, got 1.0"),
        ({"gamma": "high"}, "gamma: must be a number at least 0 and less than 1, got 'high'"),
        ({"gamma": True}, "gamma: must be a number at least 0 and less than 1, got True"),
        ({"T": 41}, "T: must be at most mu = 40 (Eq. 10), got 41"),
        ({"mu": 50}, "window: must be at least mu + T = 70, got 60"),
        (
            {"algo": "sac"},
            "algo: must be one of cacla, cacla_var, icac, ddpg, td3, curious_ddpg, curious_td3, got 'sac'",
        ),
        (
            {"arm": "puma"},
            "arm: must be one of planar2, nico4 or the path of a .toml file, a model file or a folder with one .toml, "
            "got 'puma'",
        ),
        ({"preset": "mine"}, "preset: must be one of paper, paper-literal, best, got 'mine'"),
        ({"seeds": 0}, "seeds: must be a whole number at least 1 and at most 10000000, got 0"),
        ({"bootstrap_at_goal": 1}, "bootstrap_at_goal: must be true or false, got 1"),
        ({"joint_low": (0.0,)}, "joint_low: must be 2 numbers for planar2, got 1"),
        ({"joint_low": 5.0}, "joint_low: must be a list of numbers at least -36000 and at most 36000, got 5.0"),
        (
            {"joint_low": (0.0, "x")},
            "joint_low: must be a list of numbers at least -36000 and at most 36000, got (0.0, 'x')",
        ),
        ({"arm": 3}, "arm: must be text, got 3"),
        (
            {"algo": "ppo_icac"},
            "algo: must be one of cacla, cacla_var, icac, ddpg, td3, curious_ddpg, curious_td3, got 'ppo_icac'"
            "; did you mean icac?",
        ),
        (
            {"algo": ["icac"]},
            "algo: must be one of cacla, cacla_var, icac, ddpg, td3, curious_ddpg, curious_td3, got ['icac']",
        ),
        ({"algo": 3}, "algo: must be one of cacla, cacla_var, icac, ddpg, td3, curious_ddpg, curious_td3, got 3"),
        ({"algo": "cacla", "e_max": 0.5}, "e_max: no option of cacla, only of icac, curious_ddpg, curious_td3"),
        (
            {"algo": "cacla_var", "map_input": "state"},
            "map_input: no option of cacla_var, only of icac, curious_ddpg, curious_td3",
        ),
        ({"observation_size": 4}, "observation_size: no such option"),
    ],
)
def test_wrong_options_give_one_line(options, line):
    with pytest.raises(ConfigError) as caught:
        resolve(**options)
    assert str(caught.value) == line


@given(
    st.sampled_from(sorted(all_options())),
    st.one_of(
        st.floats(), st.integers(), st.text(max_size=5), st.booleans(), st.none(), st.lists(st.floats(), max_size=3)
    ),
)
def test_any_value_is_taken_or_refused_in_one_line_that_names_a_field(name, value):
    refusal = refused(name, value)
    assert "\n" not in refusal
    assert refusal.split(":")[0] in ("", *all_options())


@pytest.mark.parametrize("value", [[], [[]], {}, {"a": 1}, [None], b"x"], ids=repr)
def test_what_is_no_key_is_refused_like_any_other_value(value):
    """Values that cannot be looked up in a table, for every option."""
    for name in all_options():
        assert refused(name, value).split(":")[0] in ("", *all_options()), name


def refused(name, value):
    try:
        resolve(**{name: value})
    except ConfigError as error:
        return str(error)
    return ""


def test_defaults_are_the_papers():
    planar, nico = resolve(), resolve(arm="nico4")
    assert (planar.run.seeds, planar.run.episodes, nico.run.episodes) == (20, 1000, 15000)
    for each in (planar, nico):
        h = each.hyper
        assert (h.gamma, h.actor_rate, h.critic_rate, h.predictor_rate, h.beta) == (0.9, 0.01, 0.01, 0.01, 0.01)
        assert (h.e_max, h.map_rate, h.mu, h.T) == (0.9, 1e-4, 40, 20)
        assert (each.spec.hidden_units, each.spec.hidden_layers, each.params.horizon) == (12, 1, 50)
        assert each.params.action_bound == 10.0
    assert (planar.params.goal_radius, planar.params.goal_reward) == (0.3, 50.0)
    assert (nico.params.goal_radius, nico.params.goal_reward) == (pytest.approx(0.0379, abs=1e-4), 100.0)
    assert planar.hyper.sigma * 10 == pytest.approx(math.degrees(0.1))
    assert (nico.hyper.sigma, nico.params.reset_range) == (1.0, 0.25)


def test_literal_preset():
    planar, nico = resolve(preset="paper-literal"), resolve(arm="nico4", preset="paper-literal")
    assert planar.params.joint_low == (-180.0, -180.0)
    assert (nico.params.reset_range, nico.hyper.sigma, planar.hyper.sigma) == (1.0, 0.1, 0.1)
    for spec in (planar.spec, nico.spec):
        assert (spec.critic_target, spec.variance_order, spec.action_clipping) == ("previous", "previous", "output")
        assert (spec.window_mean, spec.learning_progress_time) == ("mu", "previous")
    with pytest.raises(ConfigError, match=r"window: must be at least mu \+ T \+ 1 = 61"):
        resolve(preset="paper-literal", window=60)


def test_what_the_user_says_wins_over_the_preset():
    assert resolve(arm="nico4", sigma=0.25).hyper.sigma == 0.25


@pytest.mark.parametrize("arm", ["planar2", "nico4"])
@pytest.mark.parametrize("preset", ["paper", "paper-literal"])
@pytest.mark.parametrize("algo", registry.learners())
def test_settings_survive_their_own_file(arm, preset, algo):
    more = {"perception_half_life": 7.0} if "perception_half_life" in options_of(algo) else {}
    original = resolve(arm=arm, preset=preset, gamma=0.5, algo=algo, **more)
    again = resolve(**tomllib.loads(folder.config_text(original)))
    assert again == original
    assert resolve(**original.flat()) == original
    # `tip` and a warm map are only there where they are given: version 0.1.0 reads the other files too.
    of_the_map = {name for name, field in options_of(algo).items() if applies(field, {"map": "itm"})}
    assert set(original.flat()) | set(UNSAID) == of_the_map
    assert set(defaults(arm, preset, algo)) == set(options_of(algo))


OF_ONE_MAP = {
    "itm": {"e_max": 0.5, "map_rate": 0.1, "spacing_removal": "none"},
    "gng": {"gng_interval": 7, "gng_rate": 0.1, "map_capacity": 20},
    "som": {"som_side": 3, "som_dimensions": 3, "som_radius": 1.5, "map_init_range": 0.5},
    "grid": {"grid_side": 3},
}


@pytest.mark.parametrize("kind", OF_ONE_MAP)
def test_a_map_has_its_own_options(kind):
    settings = resolve(map=kind, **OF_ONE_MAP[kind])
    flat = settings.flat()
    assert flat["map"] == kind
    assert OF_ONE_MAP[kind].items() <= flat.items()
    assert resolve(**tomllib.loads(folder.config_text(settings))) == settings
    for other in OF_ONE_MAP.keys() - {kind}:
        for name, value in OF_ONE_MAP[other].items():
            if name in flat:  # several maps have it
                continue
            with pytest.raises(ConfigError, match=rf"^{name}: no option of the map {kind}, only of .*{other}"):
                resolve(map=kind, **{name: value})
    assert resolve(**of_learner({"map": kind} | OF_ONE_MAP["gng"] | OF_ONE_MAP["itm"])).spec.map == kind


def test_every_option_says_what_it_is():
    for name, field in all_options().items():
        assert field.metadata["help"], name
        assert field.metadata["source"], name
        assert len(field.metadata["help"]) <= 60, name


@pytest.mark.parametrize("learner", registry.learners().values(), ids=registry.learners())
def test_names_are_used_once(learner):
    records = (RunOptions, ReachParams, learner.static, learner.traced)
    names = [field.name for record in records for field in dataclasses.fields(record)]
    assert len(names) == len(set(names))


def test_traced_numbers_are_strongly_typed():
    leaves = jax.tree.leaves(Hyper(curiosity=2.0).traced())  # what is neutral is not there
    assert len(leaves) == len(dataclasses.fields(Hyper))
    assert all(not leaf.weak_type for leaf in leaves)
    assert {leaf.dtype for leaf in leaves} == {jnp.dtype("float32"), jnp.dtype("int32"), jnp.dtype("bool")}


def test_python_users_are_told_too():
    with pytest.raises(ConfigError, match=r"^state_size: must be at most observation_size"):
        Spec(observation_size=2, state_size=3)
    with pytest.raises(ConfigError, match=r"^map_capacity: must be a whole number at least 2"):
        Spec(map_capacity=1)
    with pytest.raises(ConfigError, match=r"^optimizer: must be one of sgd, adam, rmsprop, got 'adamw'"):
        CaclaSpec(optimizer="adamw")
    for record in (Hyper, CaclaHyper):
        with pytest.raises(ConfigError, match=r"^gamma: must be a number at least 0 and less than 1, got 2.0"):
            record(gamma=2.0)
        with pytest.raises(ConfigError, match=r"^beta: must be a number greater than 0"):
            record().replace(beta=0.0)
    with pytest.raises(ConfigError, match=r"^window: must be at least mu \+ T = 60, got 10"):
        icac.agent(Spec(window=10)).check(Hyper())
    icac.agent(Spec()).check(Hyper())


def test_spec_is_hashable_and_equal_by_value():
    for record in (Spec, CaclaSpec):
        assert hash(record(hidden_units=5)) == hash(record(hidden_units=5))
        assert record(hidden_units=5) != record(hidden_units=6)
    assert icac.agent(Spec(hidden_units=5)) is icac.agent(Spec(hidden_units=5))
