"""PPO in one file, in the manner of CleanRL, on a frozen task in one compiled batch.

    python examples/cleanrl_ppo.py --id two_wheeler/Balance-v0 --updates 60

Needs `make setup-training`. The default takes a minute or two of one core.
"""

import argparse

import gymnasium
import numpy as np
import torch
from torch import nn

import bike_training  # noqa: F401 (registers the ids)

GAMMA, GAE_LAMBDA, CLIP, EPOCHS, MINIBATCHES = 0.99, 0.95, 0.2, 4, 4


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Return a small network."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


def main() -> None:
    """Learn, and print reward and length of episodes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--id", default="two_wheeler/Pushes-v0", help="one of the frozen tasks")
    parser.add_argument("--count", type=int, default=64, help="vehicles")
    parser.add_argument("--steps", type=int, default=64, help="decisions of each between two updates")
    parser.add_argument("--updates", type=int, default=30)
    args = parser.parse_args()
    torch.set_num_threads(1)  # these networks are too small to share out
    torch.manual_seed(0)
    envs = gymnasium.make_vec(args.id, num_envs=args.count, vectorization_mode="vector_entry_point")
    size, columns = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    actor, critic, log_std = network(size, columns), network(size, 1), nn.Parameter(torch.full((columns,), -1.0))
    parameters = [*actor.parameters(), *critic.parameters(), log_std]
    optimizer = torch.optim.Adam(parameters, lr=1e-3)
    observation = torch.as_tensor(envs.reset(seed=0)[0])
    lengths, finished = np.zeros(args.count), []
    for update in range(args.updates):
        rollout = []
        for _ in range(args.steps):
            with torch.no_grad():
                policy = torch.distributions.Normal(actor(observation), log_std.exp())
                action = policy.sample()
                log_prob, value = policy.log_prob(action).sum(1), critic(observation)[:, 0]
            following, reward, terminated, truncated, _ = envs.step(action.clamp(-1.0, 1.0).numpy())
            done = terminated | truncated
            lengths += 1
            finished += lengths[done].tolist()
            lengths[done] = 0
            rewards, dones = torch.as_tensor(reward).float(), torch.as_tensor(done).float()
            rollout.append((observation, action, log_prob, value, rewards, dones))
            observation = torch.as_tensor(following)
        observations, actions, log_probs, values, rewards, dones = map(torch.stack, zip(*rollout, strict=True))
        with torch.no_grad():
            next_value, advantage, advantages = critic(observation)[:, 0], torch.zeros(args.count), []
            for k in reversed(range(args.steps)):
                alive = 1.0 - dones[k]
                error = rewards[k] + GAMMA * next_value * alive - values[k]
                advantage, next_value = error + GAMMA * GAE_LAMBDA * alive * advantage, values[k]
                advantages.insert(0, advantage)
        targets = torch.stack(advantages) + values
        batch = [part.flatten(0, 1) for part in (observations, actions, log_probs, targets - values, targets)]
        for _ in range(EPOCHS):
            for places in torch.randperm(len(batch[0])).chunk(MINIBATCHES):
                seen, acted, before, gain, target = (column[places] for column in batch)
                ratio = (torch.distributions.Normal(actor(seen), log_std.exp()).log_prob(acted).sum(1) - before).exp()
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                loss = -torch.min(ratio * gain, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * gain).mean()
                loss = loss + 0.5 * (critic(seen)[:, 0] - target).square().mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(parameters, 0.5)
                optimizer.step()
        last = f"the last 200 episodes {np.mean(finished[-200:]):.0f} decisions long" if finished else "none finished"
        print(f"update {update + 1}: mean reward {rewards.mean():.3f}, {last}")
    envs.close()


if __name__ == "__main__":
    main()
