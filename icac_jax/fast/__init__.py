"""What is written out for speed, where plain functions would say the same in fewer lines.

A step of the learner is some thousands of floating-point operations, but compiled as it stands it starts hundreds
of small loops on a CPU, each over too few entries for vectors. Figures are microseconds of
processor time for one step of all lanes on one core, measured in turn with the code before (docs/performance.md):

- `lanes_last`, with `flat`, `rows` and `layouts`: the lanes as the last axis, so that every loop is over lanes; what is
  needed again is computed once. `kernel`: the whole chunk of steps is one kernel. 16 lanes of ICAC on one core: from 58
  to 9 (nico4 kinematic), from 70 to 11 (nico4 servo).
- `blocks`: a device's lanes in parts that a cache holds, sixteen each. What it bought is in docs/performance.md.
- `scalars`, with `folding` and `moves`: `mjx.step` and `mjx.kinematics` followed number by number. A control step of 10
  lanes went from 57 to 1.8 (planar2) and from 516 to 17 (nico4), compiling from 13 to 1 s and from 33 to 8-16 s. On two
  cores nico4's physics is 3.5 (20 lanes) to 4.9 (640) times as fast as C MuJoCo's own `rollout`.
- `arithmetic`: what `scalars` gives as plain data, so that it can be kept: 2.3 s of each start became 0.03 s.
- `threefry`: the draws of `jax.random`, to the bit. 340 of 650 started operations of a step became part of others. Its
  time was not measured apart; with rarer resets and `scalars` a step went from 211 to 67 (nico4 kinematic, icac).
- `sums`: small products, sums and minima in place of `@`, `jnp.sum` and `jnp.min`. From 67 to 48 at 10 lanes (nico4
  kinematic, icac), from 3,472 to 2,226 at 320 (nico4 servo, icac).
- `compiling`: options of the compiler that change no result: no operation split over threads where each core has a
  device, the widest vectors.

A file can go when a newer XLA makes the plain function as fast. To tell: put the plain function in its place, time both
in turn on one quiet machine (`make bench`), and see whether `tests/test_bench.py` counts no more operations in the
compiled chunk than before. Without `threefry` the draws stay as they are (`tests/test_keys.py`); without the others
results change in their last digits, so records of before are no longer met to the bit.
"""
