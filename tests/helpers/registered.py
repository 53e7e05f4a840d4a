"""Claims of reports, compared with those of the register."""

from collections.abc import Iterable

from astray.report.claims import Claim
from docs.register import fits, register, rule_of


def unstated(name: str, claims: Iterable[Claim]) -> list[str]:
    """Return a report's claims that are not registered, or with another rule."""
    stated = register().get(name, {}).get("claims", [])
    return [
        f"{claim.sentence} Supported if {rule_of(claim.ours)}."
        for claim in claims
        if not any(
            fits(one["sentence"], claim.sentence.replace("\u00a0", " "))
            and fits(one["rule"], rule_of(claim.ours))
            for one in stated
        )
    ]
