"""What a rolling-origin gate found, as notes of a solution."""

from navlearn.error_models.safeguard import GateVerdict
from navlearn.recipe.spec_base import SafeguardSpec


def gate_notes(verdict: GateVerdict, safeguard: SafeguardSpec, *, used: bool) -> dict[str, object]:
    """Return whether a model acts and why, with the gate's figures.

    Args:
        verdict: Of the gate.
        safeguard: What was asked of the model.
        used: Whether it acts.
    """
    found = (
        f"{100.0 * verdict.improvement:+.1f} % on {verdict.replays} emulated outages"
        if verdict.replays
        else "no emulated outage to judge by"
    )
    asked = (
        f"{100.0 * verdict.margin:g} % on at least {safeguard.gate_fewest} asked for"
        if safeguard.gate
        else "not asked for: the spec switches the gate off"
    )
    return {
        "used": used,
        "reason": f"rolling-origin gate: {found}, {asked}",
        "gate_improvement_percent": 100.0 * verdict.improvement,
        "gate_replays": verdict.replays,
    }
