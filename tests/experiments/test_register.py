"""The register says what the studies claim, and its page is current."""

import shutil
from dataclasses import replace

from astray.estimate import Estimate
from astray.experiments import catalogue, outcomes
from astray.report import page
from astray.report.claims import Claim, above, corrected, every, near_zero
from astray.report.findings import Findings, Heading
from docs import register
from helpers import registered

PAGE = register.PAGE
ONE = Estimate(0.97, 0.95, 0.98, 3, 100, 300, 2.0)


def test_the_page_is_current():
    assert register.PAGE.read_text("utf-8") == register.page(), "python docs/register.py"


def test_what_was_measured_is_of_claims_as_they_are_now():
    for name, sizes in register.measured().items():
        assert sizes.keys() <= catalogue.load(name).sizes.keys()
        for report in sizes.values():
            told = {of: ours.rpartition(" (")[0] for of, ours in report["claims"].items()}
            claims = [Claim(of, "", ours, True) for of, ours in told.items()]
            assert not registered.unstated(name, claims)


def test_what_reports_measured_is_added_to_the_register(tmp_path, monkeypatch):
    heading = Heading(**dict.fromkeys(Heading.__annotations__, ""))
    what, much = "Where the gap is two rows higher, it walks into the lava.", replace(ONE, mean=0.6)
    claims = corrected([above(what, "", "burns", much, 0.5), above("It flies.", "", "m", ONE, 0.5)])
    findings = Findings(answer="", claims=claims, settings={})
    page.write(heading, findings, tmp_path / "lava-bridge-smoke")
    page.write(heading, findings, tmp_path / "no-such-study-smoke")
    monkeypatch.setattr(register, "PAGE", tmp_path / PAGE.name)
    shutil.copy(PAGE.with_suffix(".toml"), tmp_path)
    register.PAGE.with_suffix(".json").write_text("{}")
    register.add(tmp_path)
    assert register.measured().keys() == {"lava-bridge"}
    claim = {
        "sentence": "Where the gap is two rows …, it walks into the lava.",
        "rule": "above 50 %",
    }
    said = register._said("lava-bridge", claim)
    assert said.startswith("`smoke`, supported: higher: burns: 60.0 % (95.0 to 98.0, over 3 agents")
    assert "supported if" not in said and "; p = " in said
    assert not register._said("lava-bridge", claim | {"rule": "above 70 %"}), "an earlier bound"


def test_every_study_is_in_the_register():
    assert set(register.register()) == set(catalogue.NAMES)


def test_a_claim_that_is_not_in_the_register_is_found():
    known = "In unseen levels like those of its training, the mouse reaches the cheese."
    assert not registered.unstated("maze-corner", corrected([above(known, "", "m", ONE, 0.95)]))
    assert registered.unstated("maze-corner", [above(known, "", "m", ONE, 0.85)])
    assert registered.unstated("maze-corner", [above("It flies.", "", "m", ONE, 0.95)])
    assert registered.unstated("no-such-study", [above(known, "", "m", ONE, 0.95)])


def test_the_rule_of_a_claim_is_read_off_its_report():
    one, other = above("s", "p", "m", ONE, 0.9), near_zero("s", "p", "m", ONE, 0.1)
    both = every("s", "p", [one, other])
    rules = [
        register.rule_of(claim.ours) for claim in (one, other, both, Claim("s", "p", "m", True))
    ]
    assert rules == [
        "above 90 %",
        "all of it is within 10 % of 0",
        "above 90 % and all of it is within 10 % of 0",
        "",
    ]
    assert [register.rule_of(claim.ours) for claim in corrected([one, other])] == rules[:2]


def test_a_design_that_changed_is_exploratory_unless_its_seeds_are_fresh():
    plan = catalogue.load("lava-land").sizes["smoke"]
    study = {"before": "yes", "changes": ["more steps"]}
    assert plan.first_seed == 5 and "| `smoke` | 5 to 9 |" in register.page()
    fresh = register._about(study, {"smoke": plan})
    assert fresh.endswith("at other seeds:") and "Exploratory" not in fresh
    old = register._about(study, {"smoke": plan, "night": replace(plan, first_seed=0)})
    assert old.startswith("*Exploratory.*")


def test_a_plan_finds_more_with_more_agents():
    plan = catalogue.load("maze-corner").sizes["smoke"]
    few, many = (replace(plan, seeds=seeds).power() for seeds in (2, 10))
    assert few[0] > 2 * many[0] and few[1] > 2 * many[1] > 0.2
    assert few[2] != few[2], "there are no two kinds"
    kinds = catalogue.load("minimax-regret").sizes["smoke"].power()
    assert kinds[3] < kinds[1], "sixteen kinds tell together how much agents differ"


def test_pages_say_that_two_agents_that_differ_find_no_rates():
    plan = replace(catalogue.load("maze-corner").sizes["smoke"], seeds=2)
    told = outcomes.settings(plan)["found with a power of 80\u00a0%"].replace("\u00a0", " ")
    assert "rates 39 % from their bound, or no rates where agents differ most" in told
    alone = outcomes.settings(replace(plan, seeds=1))["found with a power of 80\u00a0%"]
    assert alone.endswith("from their bound"), "one agent differs from no other"
