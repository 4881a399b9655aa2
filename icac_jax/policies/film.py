"""`icac render`: a trained arm reaching goals without exploration, as a video, a GIF or a strip of frames."""

import contextlib
import functools
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from PIL import Image, ImageDraw

from icac_jax import console, greedy
from icac_jax.envs.model import load_model
from icac_jax.envs.pictures import Canvas
from icac_jax.fields import ConfigError
from icac_jax.policies import evaluate, saved, shipped
from icac_jax.policies.joint_space import JointSpace
from icac_jax.policies.lettering import font
from icac_jax.policies.saved import Learner
from icac_jax.runs import best_policies, build, signals

FORMATS = ("mp4", "gif", "png")
_DEFAULT = "gif"  # what the base install can write
_MOST = 1000
_LONGEST = 40  # characters of an arm's name in the caption
_STRIP_COLUMNS, _WIDE_STRIP_COLUMNS = 5, 3
_SAMPLES = 1000
_HOLD = 0.8  # seconds that the end of an episode stays


class _Film(NamedTuple):
    """Size of a frame in pixels, frames per second, frames per control step."""

    width: int
    height: int
    rate: int
    per_step: int


# A control step of the shipped arms takes 0.15 s; it is shown in 0.2 s, so that the eye can follow.
_FILMS = {"mp4": _Film(720, 640, 25, 5), "gif": _Film(480, 426, 15, 3), "png": _Film(400, 356, 0, 1)}


class Played(NamedTuple):
    """An episode to be shown.

    Attributes:
      joints: [T + 1, J] joint angles in rad before the first and after each of T control steps.
      goal: [3] in m.
      reached: whether it ended in the goal zone.
    """

    joints: np.ndarray
    goal: np.ndarray
    reached: bool


def play(learner: Learner, episodes: int, pair_seed: int = 0) -> list[Played]:
    """Episodes without exploration in the environment of the training, on the first pairs of `icac evaluate`.

    Args:
      learner: who acts.
      episodes: how many.
      pair_seed: randomness of the start and goal pairs, as in `icac evaluate`.
    """
    settings = learner.settings
    agent, env = build.agent(settings), build.environment(settings)
    hyper, params = settings.hyper.traced(), build.task(settings, learner.seed).traced()
    keys = jax.vmap(functools.partial(jax.random.fold_in, jax.random.key(pair_seed)))(jnp.arange(episodes))
    state = jax.tree.map(jnp.asarray, learner.agent)

    def one(key: jax.Array) -> tuple:
        return greedy.greedy_path(agent, env, state, key, hyper, params, settings.params.horizon)

    seen, path = jax.device_get(jax.jit(jax.vmap(one))(keys))
    return [
        Played(
            joints=np.concatenate([seen.start.joints[n, None], path.joints[n, : seen.steps[n]]]),
            goal=seen.start.goal[n],
            reached=bool(seen.reached[n]),
        )
        for n in range(episodes)
    ]


def _captioned(
    picture: np.ndarray, size: int, left: tuple[str, str], right: tuple[str, str], colour: str
) -> Image.Image:
    """The picture below two lines of text, each with something at its left and at its right, on white.

    Args:
      picture: [height, width, 3].
      size: of the letters, in pixels.
      left: what stands at the left of the upper and the lower line.
      right: what stands at the right of them.
      colour: of the lower line's right.
    """
    height, width = picture.shape[:2]
    letters, row, bar = font(size), 1.35 * size, _caption_height(size)
    image = Image.new("RGB", (width, height + bar), "white")
    image.paste(Image.fromarray(picture), (0, bar))
    draw = ImageDraw.Draw(image)
    for line, (first, last) in enumerate(zip(left, right, strict=True)):
        top = 0.3 * size + line * row
        draw.text((0.4 * size, top), first, font=letters, fill="#202428" if line else "#5a6068")
        draw.text((width - 0.4 * size, top), last, font=letters, fill=colour if line else "#5a6068", anchor="ra")
    return image


def _caption_height(size: int) -> int:
    return 2 * round(1.65 * size)


class Studio:
    """Draws frames of episodes: the arm, and joint space beside it where two joints move between walls.

    Args:
      learner: who acted.
      width: of the arm's part of a frame, in pixels.
      height: of a frame, in pixels.

    Raises:
      ConfigError: there is nothing to draw with.
    """

    def __init__(self, learner: Learner, width: int, height: int) -> None:
        arm = learner.settings.arm
        self.size = width // 30
        height -= _caption_height(self.size)
        self.canvas = Canvas(load_model(arm, lit=True), arm.tip, width, height)
        self.canvas.look_at(self._room(learner))
        params = learner.settings.params
        beside = bool(params.walls) and arm.joints == 2
        self.joint_space = JointSpace(arm, params, height) if beside else None
        self.radius = learner.settings.params.goal_radius
        self.title = f"{learner.settings.algo} on {console.shown(arm.name, _LONGEST)}, seed {learner.seed}"
        self.trained = f"after {learner.episodes:,} episodes"

    def frame(self, played: Played, number: int, time: float, per_step: int) -> Image.Image:
        """The arm `time` control steps after the start; between two steps on the straight line between the joints.

        Args:
          played: the episode.
          number: of the episode, from 1.
          time: 0 to T.
          per_step: how finely the trail is drawn, points per control step.
        """
        last = len(played.joints) - 1
        times = np.append(np.arange(0.0, time, 1 / max(per_step, 3)), time)
        way = [self._joints(played.joints, at) for at in times]
        picture = self.canvas.draw(
            way[-1], played.goal, self.radius, np.array([self.canvas.tip(joints) for joints in way])
        )
        if self.joint_space is not None:
            picture = np.concatenate([picture, self.joint_space.draw(np.array(way), played.goal)], axis=1)
        step = int(time + 1e-9)
        text, colour = f"step {step}", "#202428"
        if step == last:
            steps = f"{last} step{'s' * (last != 1)}"
            text, colour = (f"reached in {steps}", "#157a3c") if played.reached else (f"missed, {steps}", "#b3261e")
        return _captioned(picture, self.size, (self.title, f"goal {number}"), (self.trained, text), colour)

    def film(self, episodes: list[Played], rate: int, per_step: int) -> Iterator[Image.Image]:
        """All frames of all episodes in order, the last one of each held for a while."""
        for number, played in enumerate(episodes, 1):
            steps = len(played.joints) - 1
            for frame in range(steps * per_step):
                yield self.frame(played, number, frame / per_step, per_step)
            end = self.frame(played, number, steps, per_step)
            for _ in range(round(_HOLD * rate)):
                yield end

    def strip(self, episodes: list[Played]) -> Image.Image:
        """One page: one row per episode, frames evenly spread from its start to its end."""
        gap, columns = 6, _STRIP_COLUMNS if self.joint_space is None else _WIDE_STRIP_COLUMNS
        cells = [
            [
                self.frame(played, number, float(time), 3)
                for time in np.unique(np.linspace(0, len(played.joints) - 1, columns).round())
            ]
            for number, played in enumerate(episodes, 1)
        ]
        width, height = cells[0][0].size
        across = max(map(len, cells))
        page = Image.new("RGB", (across * (width + gap) - gap, len(cells) * (height + gap) - gap), "white")
        for row, line in enumerate(cells):
            for column, cell in enumerate(line):
                page.paste(cell, (column * (width + gap), row * (height + gap)))
        return page

    def _room(self, learner: Learner) -> np.ndarray:
        """Where joints and tip can be, [n, 3] in m, from some of the configurations within the limits."""
        params = learner.settings.params
        low, high = np.radians(params.joint_low), np.radians(params.joint_high)
        some = np.random.default_rng(0).uniform(low, high, (_SAMPLES, len(low)))
        return np.concatenate([np.vstack([self.canvas.tip(joints), self.canvas.anchors()]) for joints in some])

    @staticmethod
    def _joints(joints: np.ndarray, time: float) -> np.ndarray:
        """Joint angles [J] at a time in control steps."""
        before = min(int(time), len(joints) - 1)
        after = min(before + 1, len(joints) - 1)
        return joints[before] + (time - before) * (joints[after] - joints[before])


def _chosen(format: str | None, out: Path | None) -> str:
    """The format: as asked for, or as the file's name ends.

    Raises:
      ConfigError: there is no such format, or the two differ.
    """
    ending = out.suffix.lower().removeprefix(".") if out else None
    chosen = format or ending or _DEFAULT
    if chosen not in FORMATS:
        raise ConfigError(f"format: must be one of {', '.join(FORMATS)}, got {chosen!r}")
    if ending is not None and ending != chosen:
        raise ConfigError(f"out: must end in .{chosen}, got {out}")
    return chosen


def render(
    folder: Path | None,
    seed: str = saved.BEST,
    episodes: int = 4,
    format: str | None = None,
    out: Path | None = None,
    pair_seed: int = 0,
    warn: Callable[[str], None] = lambda _: None,
    policy: str = best_policies.NEWEST,
) -> Path:
    """Shows episodes of a run's trained arm; returns the file written.

    Args:
      folder: of the run; None for a policy of the package, whose film goes into the current folder.
      seed: a number or "best", see `saved.pick`.
      episodes: how many; in a strip one row each.
      format: one of `FORMATS`; by default as `out` ends, else gif.
      out: the file; by default in the run folder.
      pair_seed: randomness of the start and goal pairs, as in `icac evaluate`.
      warn: told of checkpoints that cannot be read.
      policy: "newest" or "best", see `evaluate.learners`; or one of `policies.SHIPPED`.

    Raises:
      ConfigError: an option is not allowed, a library or an extra is missing, or the file cannot be written.
      DamagedError: no checkpoint can be read.
    """
    chosen = _chosen(format, out)
    evaluate.check_pairs("episodes", episodes, _MOST, pair_seed)
    encoder = _encoder() if chosen == "mp4" else None
    learner = shipped.chosen(folder, seed, policy, warn)
    film = _FILMS[chosen]
    studio = Studio(learner, film.width, film.height)
    with contextlib.closing(studio.canvas):
        played = play(learner, episodes, pair_seed)
        name = Path(policy) if folder is None else folder / f"render-seed-{learner.seed}"
        out = out or name.with_suffix(f".{chosen}")
        with saved.writing(out) as file:
            if chosen == "png":
                studio.strip(played).save(file, "PNG", optimize=True)
            elif encoder is None:
                _write_gif(file, list(studio.film(played, film.rate, film.per_step)), film.rate)
            else:
                _write_mp4(file, studio.film(played, film.rate, film.per_step), film, encoder)
    return out


def strip(folder: Path, file: IO[bytes], episodes: int = 2) -> None:
    """Writes a strip of the best seed's first episodes as a PNG, for pages.

    Args:
      folder: of the run.
      file: where to.
      episodes: how many, a row each.

    Raises:
      ConfigError: there is nothing to draw with, or no seed that can act.
      DamagedError: no checkpoint can be read.
    """
    learner, film = saved.pick(folder), _FILMS["png"]
    studio = Studio(learner, film.width, film.height)
    with contextlib.closing(studio.canvas):
        studio.strip(play(learner, episodes)).save(file, "PNG", optimize=True)


def _encoder() -> str:
    """The program that writes mp4, from the optional extra.

    Raises:
      ConfigError: it is missing.
    """
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise ConfigError("format: mp4 needs the extra, pip install 'icac_jax[video]'; gif and png do not") from error


def _write_gif(file: IO[bytes], frames: list[Image.Image], rate: int) -> None:
    # One palette for all frames, taken from several of them: one palette per frame would flicker.
    some = frames[:: max(1, len(frames) // 8)]
    sheet = Image.new("RGB", (some[0].width, some[0].height * len(some)))
    for row, frame in enumerate(some):
        sheet.paste(frame, (0, row * frame.height))
    palette = sheet.quantize(256, method=Image.Quantize.MEDIANCUT)
    flat = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    duration = 10 * round(100 / rate)  # GIF counts in hundredths of a second
    flat[0].save(file, "GIF", save_all=True, append_images=flat[1:], duration=duration, loop=0, optimize=False)


def _write_mp4(file: IO[bytes], frames: Iterator[Image.Image], film: _Film, encoder: str) -> None:
    with tempfile.TemporaryDirectory() as place, signals.unfinished(Path(place)):  # the encoder seeks in the file
        path = Path(place) / "film.mp4"
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{film.width}x{film.height}", "-r", str(film.rate)]
        target = ["-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(path)]
        command = [encoder, "-v", "error", *source, "-i", "-", *target]
        with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
            assert process.stdin is not None
            for frame in frames:
                process.stdin.write(frame.tobytes())
            process.stdin.close()
        if process.returncode:
            raise ConfigError(f"format: the encoder of mp4 failed with status {process.returncode}")
        file.write(path.read_bytes())
