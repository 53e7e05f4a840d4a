"""Claims of reports, compared with those of the register."""

import re
from collections.abc import Iterable

from astray.report.claims import Claim
from docs.register import fits, register


def rule_of(claim: Claim) -> str:
    """Return the rule by which a claim is supported, from its report; "" if there is none."""
    rules = re.findall(r"; supported if (.*?)(?=;|, which is not enough|$)", claim.ours)
    return " and ".join(dict.fromkeys(rules)).replace("\u00a0", " ")


def unstated(name: str, claims: Iterable[Claim]) -> list[str]:
    """Return a report's claims that are not registered, or with another rule."""
    stated = register().get(name, {}).get("claims", [])
    return [
        f"{claim.sentence} Supported if {rule_of(claim)}."
        for claim in claims
        if not any(
            fits(one["sentence"], claim.sentence.replace("\u00a0", " "))
            and fits(one["rule"], rule_of(claim))
            for one in stated
        )
    ]
