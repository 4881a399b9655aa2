"""`icac plot-map`: the topological map of a seed in joint space, with how often each node was asked and how well."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter

from icac_jax.agents.coverage import CountedState
from icac_jax.agents.curious import CuriousState
from icac_jax.console import shown
from icac_jax.curiosity import predictors
from icac_jax.envs import walls
from icac_jax.envs.model import joint_names
from icac_jax.fields import ConfigError
from icac_jax.policies import saved
from icac_jax.policies.saved import Learner
from icac_jax.runs import build
from icac_jax.settings.worlds import need_joints

FORMATS = ("png", "svg")
_STYLE: dict[str, Any] = {"linewidths": 0.6, "edgecolors": "#303438", "zorder": 3}
_INK = "#303438"
_LONGEST = 60  # characters of a name in the title
_BINS = 12  # of the nodes along a joint
# Without their palest part: white is a node that was not asked yet.
_BLUES, _REDS = (ListedColormap(colormaps[name](np.linspace(0.2, 1.0, 256))) for name in ("Blues", "YlOrRd"))


class Nodes(NamedTuple):
    """The live nodes of a map, M of them.

    Attributes:
      joints: [M, J] where they are, in degrees.
      edges: [E, 2] pairs of rows of `joints`.
      queries: [M] how often each node's predictor was asked.
      errors: [M] mean of its last mu prediction errors (Eq. 9), in normalised joints; NaN where it was not asked yet.
    """

    joints: np.ndarray
    edges: np.ndarray
    queries: np.ndarray
    errors: np.ndarray


def nodes(learner: Learner) -> Nodes:
    """What the map of a learner holds.

    With a single predictor for the whole space every node has that predictor's count and error.

    Raises:
      ConfigError: the learner has no map.
    """
    settings = learner.settings
    need_joints(settings, "run", "this picture of a map")
    built = build.agent(settings).map
    state = learner.agent.agent if isinstance(learner.agent, CountedState) else learner.agent
    if built is None or not isinstance(state, CuriousState):
        signal = settings.flat().get("signal")
        who = f"the signal {signal}" if signal else settings.algo
        raise ConfigError(f"run: {who} has no map, which only a learner with curiosity has")
    curious = state.curiosity
    found = built.nodes(curious.map)
    live = np.flatnonzero(found.live)
    edges = np.zeros((len(found.live),) * 2, bool) if found.edges is None else found.edges
    low, high = np.array(settings.params.joint_low), np.array(settings.params.joint_high)
    # A map over the whole observation has the goal's coordinates behind the joints.
    place = found.weights[live, : settings.arm.joints]
    means = jax.vmap(predictors.mean_error, (0, 0, None, None))(
        jnp.asarray(curious.bank.errors), jnp.asarray(curious.bank.queries), settings.flat()["mu"], 0
    )
    queries = np.broadcast_to(curious.bank.queries, found.live.shape)[live]
    errors = np.broadcast_to(means, found.live.shape)[live]
    return Nodes(
        joints=low + (place + 1) / 2 * (high - low),
        edges=np.argwhere(np.triu(edges[np.ix_(live, live)])),
        queries=queries,
        errors=np.where(queries > 0, errors, np.nan),
    )


def figure(learner: Learner) -> Figure:
    """The map as a figure.

    Two joints: two panels. More: a square of panels, a pair of joints each, queries below and errors above the
    diagonal, and on it how many nodes lie where. An edge is then drawn for the two joints along which it runs the
    furthest, so that edges can be told apart. One joint: its angle against both.
    """
    found = nodes(learner)
    settings = learner.settings
    # Whoever made the arm named it and its joints: no dollar sign in a name begins a formula.
    names = [f"{shown(name)} [deg]" for name in joint_names(settings.arm)]
    joints = len(names)
    asked_once = np.append(found.queries[found.queries > 0], [] if found.queries.any() else [1])
    least, most = asked_once.min(), asked_once.max()
    asked = LogNorm(least, most) if most > 20 * least else Normalize(0, most)
    wrong = Normalize(0, np.nanmax(found.errors, initial=1e-9))
    side = 4.6 if joints <= 2 else 2.5 * joints
    page = Figure(figsize=(2 * side + 1.6, side) if joints <= 2 else (side + 1.2, side), layout="constrained")
    page.suptitle(_title(learner, found), fontsize=11, color=_INK, parse_math=False)
    quantities = [(found.queries, asked, _BLUES, "queries"), (found.errors, wrong, _REDS, "prediction error")]
    if joints <= 2:
        axes = page.subplots(1, 2, squeeze=False)[0]
        drawn: list[Any] = [_panel(axes[n], found, 0, joints - 1, quantities[n], learner) for n in (0, 1)]
        for panel in axes:
            panel.set_xlabel(names[0], parse_math=False)
            panel.set_ylabel(names[-1], parse_math=False)
        places = [[panel] for panel in axes]
    else:
        axes = page.subplots(joints, joints, squeeze=False, sharex="col", sharey="row")
        drawn = [None, None]
        along = furthest(found, np.subtract(settings.params.joint_high, settings.params.joint_low))
        for row in range(joints):
            for column in range(joints):
                panel = axes[row, column]
                if row == column:
                    _diagonal(panel, names[row], found.joints[:, row])
                else:
                    upper = int(column > row)
                    mine = found._replace(edges=found.edges[np.all(along == sorted((row, column)), axis=1)])
                    drawn[upper] = _panel(panel, mine, column, row, quantities[upper], learner)
                panel.label_outer()
        places = [axes, axes]
    for quantity, points, place in zip(quantities, drawn, places, strict=True):
        where = {2: "", 1: ""}.get(
            joints, ", below the diagonal" if quantity[3] == "queries" else ", above the diagonal"
        )
        bar = page.colorbar(points, ax=place, shrink=0.8 if joints <= 2 else 0.6, pad=0.02)
        bar.set_label(quantity[3] + where, color=_INK)
        bar.formatter = FuncFormatter(lambda value, _: f"{value:,g}")  # a page's style has no formulae, nor powers
    return page


def furthest(found: Nodes, ranges: np.ndarray) -> np.ndarray:
    """[E, 2] the two joints along which each edge runs the furthest, the first one before the second.

    Args:
      found: nodes and edges.
      ranges: [J] degrees between the joints' limits, of which lengths are shares.
    """
    lengths = np.abs(found.joints[found.edges[:, 0]] - found.joints[found.edges[:, 1]]) / ranges
    return np.sort(np.argsort(lengths, axis=1, kind="stable")[:, -2:], axis=1)


def _title(learner: Learner, found: Nodes) -> str:
    settings = learner.settings
    text = (
        f"map of seed {learner.seed}, {settings.algo} on {shown(settings.arm.name, _LONGEST)} "
        f"after {learner.episodes:,} episodes: {len(found.joints)} nodes, {len(found.edges)} edges"
    )
    if getattr(settings.spec, "predictors", "local") == "single":
        text += "\none predictor for the whole space"
    if learner.settings.arm.joints > 2:
        text += (
            "\nan edge is drawn for the two joints along which it runs the furthest; on the diagonal: nodes by angle"
        )
    return text


def _panel(panel: Any, found: Nodes, across: int, up: int, quantity: tuple, learner: Learner) -> Any:
    """Nodes and edges over two joints, coloured by one quantity; returns the coloured points."""
    values, scale, colours, _ = quantity
    where = found.joints[:, [across, up]]
    few = learner.settings.arm.joints <= 2
    width, style = (1.0, _STYLE | {"s": 70}) if few else (0.4, _STYLE | {"s": 30})
    panel.add_collection(LineCollection(list(where[found.edges]), colors="#a4aab0", linewidths=width, zorder=2))
    unasked = found.queries == 0
    panel.scatter(*where[unasked].T, c="white", **style)
    points = panel.scatter(*where[~unasked].T, c=values[~unasked], norm=scale, cmap=colours, **style)
    _walls(panel, across, up, learner)
    low, high = learner.settings.params.joint_low, learner.settings.params.joint_high
    for joint, limit, line in ((across, panel.set_xlim, panel.axvline), (up, panel.set_ylim, panel.axhline)):
        margin = 0.06 * (high[joint] - low[joint])
        limit(
            min(low[joint], found.joints[:, joint].min()) - margin,
            max(high[joint], found.joints[:, joint].max()) + margin,
        )
        for edge in (low[joint], high[joint]):
            line(edge, color="#c2c7cc", linewidth=0.8, linestyle=":", zorder=1)
    panel.tick_params(labelsize=8, colors=_INK)
    return points


def _walls(panel: Any, across: int, up: int, learner: Learner) -> None:
    """The boxes over two joints: dark where the other joints are of no help, pale where they may let the arm pass.

    A box that would fill the panel is left out.
    """
    params = learner.settings.params
    low, high = np.array(params.joint_low), np.array(params.joint_high)
    others = np.setdiff1d(np.arange(len(low)), [across, up])
    for lowest, highest in walls.boxes(np.asarray(params.walls, float), len(low)):
        whole = np.all((lowest[others] <= low[others]) & (highest[others] >= high[others]))
        shown = [across, up]
        if np.all((lowest[shown] <= low[shown]) & (highest[shown] >= high[shown])):
            continue
        x, y = np.maximum(lowest, low)[shown]
        width, height = np.minimum(highest, high)[shown] - (x, y)
        panel.add_patch(Rectangle((x, y), width, height, color="#7a828b" if whole else "#e6e9ec", lw=0, zorder=0.5))


def _diagonal(panel: Any, name: str, angles: np.ndarray) -> None:
    """How many nodes lie where along one joint, on the horizontal axis that the panels of its column share."""
    counts, edges = np.histogram(angles, _BINS)
    for count, low, high in zip(counts, edges[:-1], edges[1:], strict=True):
        # Heights are shares of the panel: its vertical axis is the row's angle.
        bar = Rectangle((low, 0), high - low, 0.7 * count / max(counts), color="#c2c7cc", lw=0)
        bar.set_transform(panel.get_xaxis_transform())
        panel.add_artist(bar)
    panel.set_facecolor("#f2f4f6")
    place: dict[str, Any] = {"ha": "center", "va": "top", "transform": panel.transAxes}
    panel.text(0.5, 0.95, name, color=_INK, parse_math=False, **place)
    panel.tick_params(labelsize=8, colors=_INK)


def plot(
    folder: Path, seed: str = saved.BEST, out: Path | None = None, warn: Callable[[str], None] = lambda _: None
) -> Path:
    """Draws the map of a seed of a run; returns the file written.

    Args:
      folder: of the run.
      seed: a number or "best", see `saved.pick`.
      out: the file, PNG or SVG as it ends; by default a PNG in the run folder.
      warn: told of checkpoints that cannot be read.

    Raises:
      ConfigError: the run has no map, an option is not allowed, or the file cannot be written.
      DamagedError: no checkpoint can be read.
    """
    ending = out.suffix.lower().removeprefix(".") if out else FORMATS[0]
    if ending not in FORMATS:
        raise ConfigError(f"out: must end in .{' or .'.join(FORMATS)}, got {out}")
    learner = saved.pick(folder, seed, warn)
    page = figure(learner)
    out = out or folder / f"map-seed-{learner.seed}.{ending}"
    with saved.writing(out) as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        page.savefig(file, format=ending, dpi=160)
    return out
