"""Policies that other libraries trained, played by the real ones: each as it plays by itself."""

from functools import partial

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from torch import nn

from astray.acting import steps
from astray.agents.recurrent import Recurrent
from astray.analysis.adapters import Function, from_sb3, from_torchrl
from astray.analysis.cleanrl import from_cleanrl
from astray.analysis.evaluate import evaluate
from astray.analysis.trained import Network
from helpers.rooms import CELLS, WORLD, Room

LEVELS = np.array([3, 1, 4, 15, 9, 2, 6, 53, 58, 97])
SPACE = Room().observation_space
COLUMNS = ("level", "return", "length", "reached_square", "reached_end")


class Model(nn.Module):
    """An actor and a critic on one body, as CleanRL writes them."""

    def __init__(self, actions=2):
        super().__init__()
        torch.manual_seed(1)
        self.network = nn.Sequential(nn.Flatten(), nn.Linear(2 * CELLS, 16), nn.Tanh())
        self.actor, self.critic = nn.Linear(16, actions), nn.Linear(16, 1)

    def get_action_and_value(self, seen):
        hidden = self.network(seen)
        drawn = torch.distributions.Categorical(logits=4 * self.actor(hidden))
        return drawn.sample(), self.critic(hidden)


def both(agent, seen):
    hidden = agent.network(seen)
    return 4 * agent.actor(hidden), agent.critic(hidden)


def by_hand(choose):
    """The actions of an episode in each level, in a loop over one environment."""
    found = []
    for level in LEVELS.tolist():
        env, memory, ended, taken = Room("anywhere"), None, False, []
        seen, _ = env.reset(seed=level)
        while not ended:
            action, memory = choose(seen, memory)
            seen, _, terminated, truncated, _ = env.step(action)
            taken.append(int(action))
            ended = terminated or truncated
        found.append(taken)
    return found


def played(policy, batch):
    found = {level: [] for level in range(len(LEVELS))}
    for step in steps(policy, WORLD, "anywhere", LEVELS, batch=batch):
        for level, action in zip(step.level.tolist(), step.actions.tolist(), strict=True):
            found[level].append(action)
    return list(found.values())


def test_a_recurrent_model_of_sb3_contrib_plays_as_by_hand():
    contrib = pytest.importorskip("sb3_contrib")
    model = contrib.RecurrentPPO("MlpLstmPolicy", Room("anywhere"), seed=3, device="cpu")
    with torch.no_grad():
        model.policy.action_net.weight.mul_(300)  # else one action is the likeliest throughout

    def choose(seen, memory):
        return model.predict(seen, memory, np.array([memory is None]), deterministic=True)

    hand = by_hand(choose)
    assert len({action for taken in hand for action in taken}) == 2
    assert played(from_sb3(model, greedy=True), 3) == hand


def test_a_model_that_masks_actions_is_refused():
    contrib = pytest.importorskip("sb3_contrib")
    env = Room("anywhere")
    env.action_masks = lambda: np.ones(2, bool)
    model = contrib.MaskablePPO("MlpPolicy", env, n_steps=16, device="cpu")
    with pytest.raises(ValueError, match="so that MaskablePPO would take actions that its masks"):
        from_sb3(model)


def test_the_network_of_a_model_sees_planes_as_the_model_does():
    sb3 = pytest.importorskip("stable_baselines3")
    from astray.envs.sb3 import GameVecEnv

    shown = {"observation": "symbolic", "autoreset_mode": "SameStep"}
    env = GameVecEnv(gymnasium.make_vec("astray/maze-corner-small-v0", 2, **shown))
    model = sb3.PPO("MlpPolicy", env, n_steps=8, batch_size=16, device="cpu")
    policy, seen = from_sb3(model, observation="symbolic", greedy=True), env.reset()
    assert policy.network.space.shape == seen.shape[1:] == (4, 7, 7)
    logits, values = policy.network.outputs(seen)
    assert logits.argmax(-1).tolist() == model.predict(seen, deterministic=True)[0].tolist()
    assert values.shape == (2,)


def test_a_model_of_stacked_frames_is_told_that_none_are_stacked_here():
    """It was advised to take symbols or images, of which it had seen the right ones."""
    sb3 = pytest.importorskip("stable_baselines3")
    env = sb3.common.vec_env.DummyVecEnv([partial(Room, "anywhere")])
    stacked = sb3.common.vec_env.VecFrameStack(env, 4)
    model = sb3.PPO("MlpPolicy", stacked, n_steps=8, batch_size=8, device="cpu")
    with pytest.raises(ValueError, match="stacks no frames, as VecFrameStack does; a Function"):
        played(from_sb3(model), 3)


class Shown(Room):
    """The room as an image of 64 x 64, with its colours first or last."""

    def __init__(self, first):
        super().__init__("anywhere")
        self.shape = (3, 64, 64) if first else (64, 64, 3)
        self.observation_space = Box(0, 255, self.shape, np.uint8)


@pytest.mark.parametrize("first", [True, False])
def test_the_network_of_a_model_sees_images_as_the_model_does(first, tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    model = sb3.PPO("MlpPolicy", Shown(first), n_steps=8, batch_size=8, device="cpu", seed=2)
    model.save(tmp_path / "model.zip")
    loaded = sb3.PPO.load(tmp_path / "model.zip", env=Shown(first), device="cpu")
    seen = np.random.default_rng(0).integers(0, 255, (64, *Shown(first).shape), np.uint8)
    theirs = model.policy.get_distribution(model.policy.obs_to_tensor(seen)[0]).distribution.logits
    for one in (model, loaded):
        assert torch.allclose(from_sb3(one).network.outputs(seen)[0], theirs, atol=1e-6)
    alone = from_sb3(sb3.PPO.load(tmp_path / "model.zip", device="cpu")).network
    if first:  # images of games have their colours last
        with pytest.raises(ValueError, match=r"sees observations of shape \(64, 64, 3\), not"):
            alone.outputs(seen)
    else:
        assert torch.allclose(alone.outputs(seen)[0], theirs, atol=1e-6)


def test_a_model_of_normalized_observations_acts_on_those():
    sb3 = pytest.importorskip("stable_baselines3")
    vectors = sb3.common.vec_env
    env = vectors.VecNormalize(vectors.DummyVecEnv([partial(Room, "anywhere")]))
    model = sb3.PPO("MlpPolicy", env, n_steps=64, batch_size=64, seed=1, device="cpu").learn(512)
    seen = np.random.default_rng(0).normal(size=(200, *env.observation_space.shape))
    hand = model.predict(env.normalize_obs(seen), deterministic=True)[0].tolist()
    assert hand != model.predict(seen, deterministic=True)[0].tolist()
    policy = from_sb3(model, greedy=True)
    assert policy.choose(seen, None, np.ones(200, bool))[0].tolist() == hand
    assert policy.network is None


def actor_of_torchrl(recurrent, one_hot):
    modules = pytest.importorskip("torchrl.modules")
    from tensordict.nn import ProbabilisticTensorDictModule, TensorDictModule
    from tensordict.nn import TensorDictSequential as Sequential

    torch.manual_seed(4 if recurrent else 2)  # with which both actions are taken
    body = nn.Sequential(nn.Flatten(), nn.Linear(2 * CELLS, 8), nn.Tanh())
    parts = [TensorDictModule(body, ["observation"], ["embedded"])]
    if recurrent:
        parts.append(modules.GRUModule(8, 8, in_keys=["embedded", "memory"],
                                       out_keys=["embedded", ("next", "memory")]))  # fmt: skip
    head = nn.Linear(8, 2)
    with torch.no_grad():
        head.weight.mul_(30)
    kind = modules.OneHotCategorical if one_hot else torch.distributions.Categorical
    return Sequential(
        *parts,
        TensorDictModule(head, ["embedded"], ["logits"]),
        ProbabilisticTensorDictModule(["logits"], ["action"], distribution_class=kind),
    )


@pytest.mark.parametrize("recurrent, one_hot", [(False, False), (False, True), (True, False)])
def test_an_actor_of_torchrl_plays_as_by_hand(recurrent, one_hot):
    actor = actor_of_torchrl(recurrent, one_hot)
    from tensordict import TensorDict
    from tensordict.nn import InteractionType, set_interaction_type

    def choose(seen, memory):
        begins = np.array([[memory is None]])
        told = TensorDict({"observation": seen[None], "is_init": begins, **(memory or {})}, [1])
        with torch.no_grad(), set_interaction_type(InteractionType.DETERMINISTIC):
            said = actor(told)
        action = said["action"].argmax(-1) if one_hot else said["action"]
        return int(action[0]), dict(said.get("next", {}).items())

    hand = by_hand(choose)
    assert len({action for taken in hand for action in taken}) == 2
    policy = from_torchrl(actor, greedy=True, one_hot=one_hot)
    assert played(policy, 3) == played(policy, 256) == hand


def test_an_actor_of_torchrl_that_learns_from_sequences_is_asked_step_by_step():
    """Episodes side by side were taken for steps of one, so that each had another's memory."""
    actor = actor_of_torchrl(True, False)
    policy = from_torchrl(actor, greedy=True)
    alone = played(policy, 1)
    actor.module[1].default_recurrent_mode = True
    assert played(policy, 1) == played(policy, 3) == played(policy, 256) == alone
    with pytest.importorskip("torchrl.modules").set_recurrent_mode(True):
        assert played(policy, 3) == alone


def test_an_actor_of_torchrl_is_asked_in_evaluation_mode_and_is_then_as_it_was():
    actor = actor_of_torchrl(False, False)
    actor.module[0].module.append(nn.Dropout(0.5)).append(frozen := nn.Dropout(0.5))
    policy = from_torchrl(actor.train(), greedy=True)
    frozen.eval()
    assert played(policy, 3) == played(policy, 3)
    assert actor.training and actor.module[0].module[-2].training and not frozen.training


def test_a_network_plays_its_likeliest_action_or_draws_it_whatever_the_batch():
    agent = Model()

    def choose(seen, memory):
        return int(both(agent, torch.from_numpy(seen[None]))[0].argmax()), None

    assert played(Network(agent, SPACE, ask=both, mode="greedy"), 4) == by_hand(choose)
    one, other, third = (Network(agent, SPACE, ask=both, seed=seed) for seed in (0, 0, 1))
    assert played(one, 1) == played(other, 256) != played(third, 256)


def test_a_network_draws_its_actions_as_often_as_its_own_library_does():
    agent, seen = Model(), torch.zeros(1, 2, CELLS)
    seen[0, 0, 4] = seen[0, 1, 0] = 1
    rate = both(agent, seen)[0].softmax(-1)[0, 1].item()
    own = agent.get_action_and_value(seen.expand(4000, -1, -1))[0].float().mean().item()
    # The square lies at the left in one level of nine.
    levels = [k for k in range(9000) if (env := Room("anywhere")).reset(seed=k) and not env.square]
    first = next(iter(steps(Network(agent, SPACE, ask=both), WORLD, "anywhere", levels, batch=900)))
    wide = 4 * np.sqrt(rate * (1 - rate) / len(levels))
    assert abs(first.actions[:900].mean() - rate) < wide and abs(own - rate) < wide


class Kept(Recurrent):
    """It says in its logits whether it is being trained."""

    memory = 1

    def recall(self, observation, state, begins):
        logits = torch.tensor([[0.0, 9.0 * self.training]]).expand(len(state), 2)
        return logits, state[:, 0], state


@pytest.mark.parametrize(
    "module, ask",
    [(Kept(), None), (nn.Dropout(), lambda net, x: net(torch.ones(len(x), 200))[:, :2])],
)
def test_a_network_amid_a_training_plays_without_dropout_and_is_then_trained_with_it(module, ask):
    network = Network(module.eval(), SPACE, ask=ask)
    before = played(network, 4)
    assert not module.training
    module.train()
    assert played(network, 4) == before and module.training
    seen = np.zeros((3, *SPACE.shape), np.float32)
    assert network.outputs(seen, episode=True)[0].unique(dim=0).shape == (1, 2)
    assert module.training


def averaged(agent, seen):
    """Logits of the right shape that are the mean over the batch."""
    return both(agent, seen)[0].mean(0, keepdim=True).expand(len(seen), -1)


def dropped(agent, seen):
    """Logits of a network whose dropout is on."""
    logits = both(agent, seen)[0]
    return logits + torch.rand_like(logits)


def of_lstm(network, seen):
    """Logits of an LSTM that takes the batch [N, D] for a sequence of N steps."""
    return network(seen)[0]


class Forgetful(Recurrent):
    """It returns one row of logits for the whole batch."""

    memory = 1

    def recall(self, observation, state, begins):
        return torch.zeros(1, 2), torch.zeros(len(state)), state


class Averaging(Recurrent):
    """Its logits are relative to the others' in its batch."""

    memory = 1

    def recall(self, observation, state, begins):
        seen = observation.flatten(1).cumsum(1)[:, -2:]
        return seen - seen.mean(0), state[:, 0], state


class Counting(Recurrent):
    """It counts steps, goes left at every third, and clears no memory; it may say what begins."""

    memory = 1

    def __init__(self, tells=False):
        super().__init__()
        self.tells = tells

    def recall(self, observation, state, begins):
        left = (state[:, 0] % 3 == 2).float() * 99
        logits = torch.stack([left, torch.full_like(left, 9)], 1) + self.tells * begins[:, None]
        return logits, state[:, 0], state + 1


@pytest.mark.parametrize("batch", [1, 4])
def test_no_episode_begins_with_the_memory_of_another(batch):
    network = Network(Counting(), SPACE, mode="greedy")
    for taken in played(network, batch):
        assert taken == [int(step % 3 != 2) for step in range(len(taken))]


def test_a_network_is_told_that_an_episode_begins_where_it_is_asked_along_one():
    network = Network(Counting(tells=True), SPACE)
    seen = np.zeros((4, *SPACE.shape), np.float32)
    told = network.outputs(seen, episode=True)[0][:, 1]
    assert told.tolist() == [10, 9, 9, 9]


class Bare(Function):
    """It returns actions without an `Answer`."""

    def __init__(self):
        super().__init__(lambda seen: np.zeros(len(seen), int))

    def actions(self, turn):
        return super().actions(turn).actions


@pytest.mark.parametrize(
    "network, said",
    [
        (Network(Model(3), SPACE, ask=both), "has 3 logits for actions of Discrete"),
        (Network(Model(), SPACE, ask=lambda agent, seen: seen), "must give logits .* got"),
        (Network(Model(), SPACE, ask=lambda agent, seen: 3), "must give logits .* got"),
        (
            Network(Model(), SPACE, ask=lambda agent, seen: agent.actor(seen)),
            "network, asked about torch.float32 .*fails: RuntimeError.*shapes cannot be multiplied",
        ),
        (Network(Model(), Box(0, 1, (3,)), ask=both), r"sees observations of shape \(3,\), not"),
        (
            Network(Model(), SPACE, ask=lambda *_: both(*_)[0] * np.nan),
            "logits that are not finite",
        ),
        (Network(Model(), SPACE, ask=averaged), "change by .* with the others of its batch"),
        (
            Network(nn.Sequential(nn.Flatten(), nn.LSTM(2 * CELLS, 2)), SPACE, ask=of_lstm),
            "change by .* with the others of its batch",
        ),
        (Network(Model(), SPACE, ask=dropped), "change by .* with every call, as with dropout"),
        (Network(Averaging(), SPACE), "change by .* with the others of its batch"),
        (Network(Forgetful(), SPACE), r"must give logits \[64, actions\], .* got \[\[1, 2\]"),
        (Bare(), "what a policy returns must be a Answer; got array"),
        (Function(lambda seen, memory, begins: 3, remembers=True), "must return actions and its"),
    ],
)
def test_a_network_or_function_that_gives_something_else_is_told(network, said):
    with pytest.raises(ValueError, match=said):
        evaluate(network, WORLD, "anywhere", LEVELS)


@pytest.mark.parametrize("batch", [1, 4])
def test_a_function_remembers_what_it_returned_for_an_episode(batch):
    def choose(seen, memory, begins):
        steps = np.zeros(len(seen), int) if memory is None else np.where(begins, 0, memory)
        return steps % 2, steps + 1

    taken = played(Function(choose, remembers=True), batch)
    assert taken == [[k % 2 for k in range(len(one))] for one in taken]


def test_continuous_actions_are_played():
    pytest.importorskip("stable_baselines3")
    from stable_baselines3 import PPO

    from astray.game import Shift, Truncated
    from astray.world import World

    make = partial(gymnasium.make, "Pendulum-v1")
    world = World(
        name="pendulum",
        variants={"one": make},
        events={"up": lambda env, info: abs(env.state[0]) < 0.2},
        goals={"up": "up"},
        ends={"time": Truncated()},
        shifts={"one": Shift("one", "one", "up", ())},
    )
    model = PPO("MlpPolicy", make(), seed=0, device="cpu")
    table = evaluate(from_sb3(model, greedy=True), world, "one", range(3))
    env, total, ended = make(), 0.0, False
    seen, _ = env.reset(seed=2)
    while not ended:
        seen, reward, terminated, truncated, _ = env.step(
            model.predict(seen, deterministic=True)[0]
        )
        total, ended = total + float(reward), terminated or truncated
    assert table["return"][2] == pytest.approx(total, rel=1e-3)


def head(before, after):
    layers = [nn.Linear(before, 5), nn.Tanh(), nn.Linear(5, 5), nn.Tanh(), nn.Linear(5, after)]
    return nn.Sequential(*layers)


def of_vectors():
    """An agent as ppo.py of CleanRL writes it, and its actor and critic of observations."""
    agent = nn.ModuleDict({"critic": head(2 * CELLS, 1), "actor": head(2 * CELLS, 2)})
    return agent, SPACE, lambda x: [agent[name](x.flatten(1)) for name in ("actor", "critic")]


def of_atari():
    """The same of ppo_atari.py, with few channels."""
    body = nn.Sequential(
        *(nn.Conv2d(4, 2, 8, stride=4), nn.ReLU(), nn.Conv2d(2, 3, 4, stride=2), nn.ReLU()),
        *(nn.Conv2d(3, 2, 3), nn.ReLU(), nn.Flatten(), nn.Linear(2 * 49, 6), nn.ReLU()),
    )
    parts = {"network": body, "actor": nn.Linear(6, 3), "critic": nn.Linear(6, 1)}
    agent, space = nn.ModuleDict(parts), Box(0, 255, (4, 84, 84), np.uint8)
    return agent, space, lambda x: [agent[n](body(x / 255.0)) for n in ("actor", "critic")]


@pytest.mark.parametrize("script", [of_vectors, of_atari])
def test_a_checkpoint_of_cleanrl_computes_what_its_script_does(script, tmp_path):
    torch.manual_seed(0)
    agent, space, forward = script()
    torch.save(agent.state_dict(), tmp_path / "ppo.cleanrl_model")
    policy = from_cleanrl(tmp_path / "ppo.cleanrl_model", space, game=WORLD)
    seen = np.stack([space.sample() for _ in range(3)])
    with torch.no_grad():
        theirs = forward(torch.from_numpy(seen))
    logits, values = policy.outputs(seen)
    torch.testing.assert_close(logits, theirs[0])
    torch.testing.assert_close(values, theirs[1][:, 0])
    if space is SPACE:
        assert evaluate(policy, WORLD, "anywhere", LEVELS).height == len(LEVELS)


IMAGES = Box(0, 255, (4, 84, 84), np.uint8)


@pytest.mark.parametrize(
    "script, space, said",
    [
        (of_atari, Box(0, 1, IMAGES.shape, np.float32), "sees images of 0 to 255, and divides by"),
        (of_atari, Box(0, 255, (84, 84, 4), np.uint8), r"does not see Box\(0, 255, \(84, 84, 4\)"),
        (of_atari, Box(0, 255, (4, 64, 64), np.uint8), r"does not see Box\(0, 255, \(4, 64, 64\)"),
        (of_vectors, Box(-1, 1, (4,)), r"does not see Box\(-1.0, 1.0, \(4,\)"),
        (of_vectors, None, "space must be a Box; got None"),
    ],
)
def test_an_agent_of_cleanrl_is_refused_for_a_space_that_it_does_not_see(
    script, space, said, tmp_path
):
    torch.save(script()[0].state_dict(), tmp_path / "ppo.cleanrl_model")
    with pytest.raises(ValueError, match=f"ppo.cleanrl_model is refused: .*{said}"):
        from_cleanrl(tmp_path / "ppo.cleanrl_model", space)


def test_a_file_of_another_agent_is_refused(tmp_path):
    path = tmp_path / "dqn.cleanrl_model"
    torch.save(nn.Linear(2, 2).state_dict(), path)
    with pytest.raises(
        ValueError, match=r"refused: it is not an agent of CleanRL's ppo\.py, .* bias"
    ):
        from_cleanrl(path, SPACE)


@pytest.mark.filterwarnings("ignore:Initializing zero-element tensors")
@pytest.mark.parametrize(
    "weights, said",
    [
        (torch.empty(2**24, 0), r"actor.0.bias is \(5,\); it would be \(16777216,\)"),
        (torch.full((5, 2 * CELLS), 1e300, dtype=torch.float64), "not all finite numbers"),
        (torch.ones(5, 2 * CELLS, dtype=torch.int64), "not all finite numbers"),
    ],
    ids=["a width without numbers", "numbers of 64 bits", "whole numbers"],
)
def test_weights_that_are_no_numbers_of_that_network_are_refused(weights, said, tmp_path):
    """A width of 2**30 in 5 kB took 4 GB and, beside two trainings, 292 s."""
    agent = of_vectors()[0].state_dict() | {"actor.0.weight": weights}
    torch.save(agent, tmp_path / "ppo.cleanrl_model")
    with pytest.raises(ValueError, match=f"refused: it is not an agent of .*{said}"):
        from_cleanrl(tmp_path / "ppo.cleanrl_model", SPACE)
