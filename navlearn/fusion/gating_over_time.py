"""The gate of :mod:`navlearn.fusion.gating` at all blocks at once, for forms that do not loop.

Only kinds of which anything was refused are gone through block by block.
"""

import torch
from torch import Tensor

from navlearn.fusion.gating import Gated, Judged, beyond_limits, weighed
from navlearn.fusion.integrity import with_reason
from navlearn.fusion.measurements import Verdict


def judged_over_time(
    model: Gated,
    nis: Tensor,
    present: Tensor,
    refused: Tensor,
    *,
    faults: Tensor | None = None,
    vouched: Tensor | None = None,
    unheard: Tensor | None = None,
) -> Judged:
    """Return which kinds pass the gate at every block.

    Args:
        model: The filter.
        nis: NIS of each kind, shape (B, K, kinds).
        present: 1.0 where a kind is measured, shape (B, K, kinds).
        refused: Consecutive refusals before the first block, shape (B, kinds).
        faults: What thresholds in metres refuse, int64, shape (B, K, kinds); None where there are
            none.
        vouched: Where others vouch for the filter, so that nothing resets, bool, shape (B, K).
        unheard: Where a kind is not listened to, bool, shape (B, K, kinds).

    Returns:
        Verdicts, the refusals after each block, and weights.
    """
    there = present > 0.5
    beyond = beyond_limits(model, nis, there, faults)
    verdict = there.to(torch.int64) * int(Verdict.ACCEPTED)
    count = torch.zeros_like(nis)
    odd = beyond.any(1) | (refused > 0.5)
    if unheard is not None:
        odd = odd | unheard.any(1)
    nowhere = [False] * nis.shape[1]
    if model.anchor is not None:
        odd = odd | odd[..., model.anchor, None]
    # The anchor first: what it does decides for the others.
    order = sorted(odd.nonzero().tolist(), key=lambda one: (one[0], one[1] != model.anchor))
    for b, kind in order:
        led: list[bool | None] = [None] * nis.shape[1]
        if model.anchor is not None and kind != model.anchor:
            resets = (verdict[b, :, model.anchor] == int(Verdict.ACCEPTED_BY_RESET)).tolist()
            seen = there[b, :, model.anchor].tolist()
            led = [one if here else None for one, here in zip(resets, seen, strict=True)]
        column, counts = _judged_column(
            beyond[b, :, kind].tolist(),
            there[b, :, kind].tolist(),
            led,
            float(refused[b, kind]),
            model.gate.reset_after,
            nowhere if vouched is None else vouched[b].tolist(),
            nowhere if unheard is None else unheard[b, :, kind].tolist(),
            alone=kind not in (model.anchor, *model.company),
        )
        verdict[b, :, kind] = torch.tensor(column, device=verdict.device)
        count[b, :, kind] = torch.tensor(counts, dtype=count.dtype, device=count.device)
    return weighed(model, torch.where(there, nis, torch.nan), with_reason(verdict, faults), count)


def _judged_column(
    beyond: list[bool],
    there: list[bool],
    led: list[bool | None],
    refused: float,
    reset_after: int,
    vouched: list[bool],
    unheard: list[bool],
    *,
    alone: bool,
) -> tuple[list[int], list[float]]:
    """Return the verdicts on one kind.

    ``led`` tells whether the anchor resets, None without it; ``alone`` whether the kind is not
    listened to where it does.
    """
    # plain numbers: members of an enumeration cost most of such a loop
    accepted, gate, opened_up = (
        int(v) for v in (Verdict.ACCEPTED, Verdict.REFUSED_BY_GATE, Verdict.ACCEPTED_BY_RESET)
    )
    absent = int(Verdict.ABSENT)
    verdicts, counts = [], []
    channels = zip(beyond, there, led, vouched, unheard, strict=True)
    for wild, seen, leader, held, deaf in channels:
        verdict = absent
        refused = min(refused, reset_after - 1.0) if held else refused
        before = refused
        if seen:
            verdict = accepted
            if wild:
                reset = refused >= reset_after if leader is None else leader
                verdict = opened_up if reset else gate
            refused = refused + 1.0 if verdict == gate else 0.0
            if leader and alone:
                verdict, refused = gate, 0.0
            if deaf:
                verdict, refused = gate, before
        verdicts.append(verdict)
        counts.append(refused)
    return verdicts, counts
