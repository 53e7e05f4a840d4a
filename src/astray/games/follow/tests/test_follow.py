"""Follow the leader, on fields drawn in text: the order is red, green, blue, yellow."""

import pytest

from astray import games
from astray.level import Level
from helpers.scenes import play, room, scene, walk

FIELD = room(8, "......y.", "@.......", "......g.", "p.r....b")


def test_the_right_order_pays_and_what_comes_out_of_turn_costs():
    env = scene("follow", room(8, "@rg.b"), "alone")
    assert play(env, "right right stay left right")[0] == [1.0, 1.0, 0.0, -0.25, -0.25]
    s = env.states[0]
    assert (s.hits, s.misses, s.right, s.wrong, s.held, s.next) == (2, 2, 1, 4, 2, 2)


@pytest.mark.parametrize("partner, steps, sphere", [("expert", 2, 0), ("anti-expert", 9, 3)])
def test_the_partner_goes_in_the_order_or_in_the_reverse_one(partner, steps, sphere):
    env = scene("follow", FIELD, partner)
    play(env, "stay " * (steps - 1))
    assert env.states[0].visited == -1
    play(env, "stay")
    assert env.states[0].visited == sphere


@pytest.mark.parametrize("rows", [("p#r....@",), ("r......@", "#.......", "p.......")])
def test_the_partner_does_not_walk_into_walls(rows):
    env = scene("follow", room(8, *rows), "expert")
    play(env, "stay stay stay stay")
    game, s = env.game, env.states[0]
    assert Level.of(game, env.variant, s).where("partner") == [(0, 0)] and s.visited == -1


@pytest.mark.parametrize("beneath", ["p", "r", "A"])  # A: the partner on a red sphere
def test_an_agent_may_stand_on_its_partner_and_on_a_sphere_and_on_both(beneath):
    game = games.find("follow")
    drawn = f"{room(8, '@......')}\n@ on {beneath}"
    level = Level.from_text(game, game.variants["expert"], drawn)
    again = Level.of(game, level.variant, level.state(solvable=False))
    assert again.to_json() == level.to_json() and str(again).endswith(f"\n@ on {beneath}")


def test_who_follows_the_partner_visits_what_it_visited_last():
    env = scene("follow", FIELD, "anti-expert")
    walk(env, "partner")
    assert env.states[0].follows == 1 and env.states[0].hits == 0 < env.states[0].misses
    env = scene("follow", FIELD, "anti-expert")
    walk(env, "order")
    assert (env.states[0].hits, env.states[0].misses) == (1, 0)


def test_an_order_is_part_of_a_level():
    game = games.find("follow")
    level = Level.from_text(game, game.variant("expert"), FIELD)
    data = level.to_json()
    data["looks"]["order"] = 23
    assert Level.from_json(game, game.variant("expert"), data).state().order == 23
    data["looks"]["order"] = 24
    with pytest.raises(ValueError, match="its order cannot be"):
        Level.from_json(game, game.variant("expert"), data).state()
