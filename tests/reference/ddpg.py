"""One update of DDPG and TD3 once more: plain NumPy, float64, back-propagation written out.

Written from Lillicrap et al. 2016 (Alg. 1) and Fujimoto et al. 2018 (Alg. 1), not from the package. What was drawn
comes in from outside.
"""

import copy

import numpy as np


class Net:
    """Fully connected, rectified hidden layers, linear or tanh output, for rows of inputs."""

    def __init__(self, layers, squash):
        # layers: list of (matrix [before, after], bias [after])
        self.layers = [(np.array(w, float), np.array(b, float)) for w, b in layers]
        self.squash = squash
        self.moments = [tuple(np.zeros_like(part) for part in (w, b, w, b)) for w, b in self.layers]

    def forward(self, rows):
        seen = [np.asarray(rows, float)]
        for number, (w, b) in enumerate(self.layers):
            z = seen[-1] @ w + b
            if number < len(self.layers) - 1:
                z = np.maximum(z, 0.0)
            elif self.squash:
                z = np.tanh(z)
            seen.append(z)
        return seen

    def __call__(self, rows):
        return self.forward(rows)[-1]

    def backward(self, rows, back):
        """Gradients of sum(back * output) by the layers, and by the rows."""
        seen = self.forward(rows)
        if self.squash:
            back = back * (1.0 - seen[-1] ** 2)
        gradients = []
        for number in reversed(range(len(self.layers))):
            w, _ = self.layers[number]
            gradients.append((seen[number].T @ back, back.sum(axis=0)))
            back = back @ w.T
            if number > 0:
                back = back * (seen[number] > 0)
        return gradients[::-1], back

    def adam(self, gradients, rate, time):
        """Kingma and Ba 2015, Algorithm 1, with the constants given there."""
        for number, ((w, b), (gw, gb), (mw, mb, vw, vb)) in enumerate(
            zip(self.layers, gradients, self.moments, strict=True)
        ):
            mw, mb = 0.9 * mw + 0.1 * gw, 0.9 * mb + 0.1 * gb
            vw, vb = 0.999 * vw + 0.001 * gw**2, 0.999 * vb + 0.001 * gb**2
            self.moments[number] = (mw, mb, vw, vb)
            least, second = 1 - 0.9**time, 1 - 0.999**time
            w = w - rate * (mw / least) / (np.sqrt(vw / second) + 1e-8)
            b = b - rate * (mb / least) / (np.sqrt(vb / second) + 1e-8)
            self.layers[number] = (w, b)

    def follow(self, source, tau):
        self.layers = [
            (tau * sw + (1 - tau) * w, tau * sb + (1 - tau) * b)
            for (w, b), (sw, sb) in zip(self.layers, source.layers, strict=True)
        ]


class Learner:
    """Actor, critics and their targets."""

    def __init__(self, actor, critics, numbers):
        self.actor, self.critics = Net(actor, True), [Net(critic, False) for critic in critics]
        self.actor_target, self.critic_targets = copy.deepcopy(self.actor), copy.deepcopy(self.critics)
        self.numbers = numbers
        self.critic_updates = self.actor_updates = 0

    def update(self, observation, action, reward, following, ended, noise, bounds=None):
        n = self.numbers
        aim = self.actor_target(following)
        if n["target_noise"]:
            aim = aim + np.clip(n["target_noise"] * noise, -n["target_noise_clip"], n["target_noise_clip"])
            aim = np.clip(aim, -1, 1)
        ahead = np.min([critic(np.hstack([following, aim])) for critic in self.critic_targets], axis=0)[:, 0]
        target = reward + n["gamma"] * (1 - ended) * ahead
        if bounds is not None:
            target = np.clip(target, *bounds)

        self.critic_updates += 1
        loss, both = 0.0, np.hstack([observation, action])
        for critic in self.critics:
            error = critic(both)[:, 0] - target
            loss += np.mean(error**2)
            gradients, _ = critic.backward(both, 2 * error[:, None] / len(error))
            critic.adam(gradients, n["critic_rate"], self.critic_updates)

        if self.critic_updates % n["policy_delay"] == 0:
            self.actor_updates += 1
            chosen = self.actor(observation)
            ones = -np.ones((len(observation), 1)) / len(observation)
            _, by_inputs = self.critics[0].backward(np.hstack([observation, chosen]), ones)
            back = by_inputs[:, observation.shape[1] :]
            if n.get("preactivation_penalty"):
                # What enters the tanh is artanh(action): its squared mean, by the action.
                before = np.arctanh(chosen)
                back = back + n["preactivation_penalty"] * 2 * before / before.size / (1 - chosen**2)
            gradients, _ = self.actor.backward(observation, back)
            self.actor.adam(gradients, n["actor_rate"], self.actor_updates)
            self.actor_target.follow(self.actor, n["tau"])
            for target_net, critic in zip(self.critic_targets, self.critics, strict=True):
                target_net.follow(critic, n["tau"])
        return loss
