"""Building parallel cascade models round by round, for many windows at once.

Source: [Iqbal2020, IV] after [Korenberg1991]. Every round draws one batch of candidates, the same
for all windows; each window adds the one that explains most of its own residual, if it passes.
A window ends by one of four rules, and what is left of the others goes on.
"""

import torch
from torch import Tensor

from navlearn.error_models.pci_acceptance import (
    acceptance_threshold,
    autocorrelations,
    effective_rows,
)
from navlearn.error_models.pci_candidates import (
    Cascades,
    Draw,
    basis,
    draw_candidates,
    fit_cascades,
    linear_responses,
)
from navlearn.error_models.pci_options import PciOptions
from navlearn.error_models.pci_polish import polish
from navlearn.error_models.pci_windows import Built, Live, Rows

DEPENDENT = 1e-10
"""What a column of unit norm has left outside the others when it is taken for one of them."""


def build_cascades(rows: Rows, options: PciOptions) -> list[tuple[Cascades, Built]]:
    """Return the cascades of each window, and how it went.

    Args:
        rows: Rows of the windows.
        options: How to build.
    """
    generator = torch.Generator().manual_seed(options.seed)
    start = rows.target.square().sum(-1)
    built = [Built(curve=[power]) for power in start.tolist()]
    live = Live(
        windows=torch.arange(len(built)),
        rows=rows,
        residual=rows.target,
        spanned=rows.root.unsqueeze(-1),
        correlations=autocorrelations(rows.lagged[..., : options.inputs], rows.root),
        response=rows.lagged[:, :0],
    )
    tried = 0
    while True:
        goes_on = [_goes_on(built[k], options) for k in live.windows.tolist()]
        if not any(goes_on):
            return [(_joined(b, k, rows, options), b) for k, b in enumerate(built)]
        if not all(goes_on):
            live = _kept(live, torch.tensor(goes_on))
        count = min(options.batch, options.tried - tried)
        tried += count
        draw = draw_candidates(count, options.order, options.lags, options.inputs, generator)
        best, passed = _best(live, draw, start[live.windows], options)
        _add(live, best, passed, options)
        left = live.residual.square().sum(-1).tolist()
        for k, window in enumerate(live.windows.tolist()):
            model = built[window]
            model.tried = tried
            model.missed = 0 if bool(passed[k]) else model.missed + 1
            if bool(passed[k]):
                model.accepted.append(Cascades(*(value[k] for value in best)))
                model.curve.append(left[k])
                if options.polish:
                    found = live.response[k]
                    model.polished = found[(found != 0.0).any(-1)]


def _goes_on(model: Built, options: PciOptions) -> bool:
    """Apply the four rules."""
    if model.curve[-1] <= options.target:
        model.stopped = "target"
    elif len(model.accepted) >= options.cascades:
        model.stopped = "cascades"
    elif model.missed >= options.misses:
        model.stopped = "none passed"
    elif model.tried >= options.tried:
        model.stopped = "tried"
    return not model.stopped


def _kept(live: Live, keep: Tensor) -> Live:
    """Return what goes on."""
    return Live(
        windows=live.windows[keep],
        rows=Rows(*(value[keep] for value in live.rows)),
        residual=live.residual[keep],
        spanned=live.spanned[keep],
        correlations=live.correlations[keep],
        response=live.response[keep],
    )


def _best(live: Live, draw: Draw, start: Tensor, options: PciOptions) -> tuple[Cascades, Tensor]:
    """Return the best candidate of each window, axes (B, 1, ...), and whether it passes, (B,)."""
    lagged, _, root, count = live.rows
    power = live.residual.square().sum(-1)
    response = linear_responses(lagged, live.residual, root, power / start, draw)
    fitted, explained = fit_cascades(lagged, live.residual, root, response, options.degree)
    paper = options.acceptance == "paper"
    if not paper:
        left = live.residual / torch.where(root > 0, root, 1.0)
        left = autocorrelations(left.unsqueeze(-1), root)
        count = effective_rows(count, live.correlations, left)
    freedom = draw.reads.sum(-1).double() + options.degree
    ways = 1 if options.inputs == 1 else options.inputs + 1
    least = acceptance_threshold(count, freedom, ways, options.level, paper)
    passes = explained > least * power.unsqueeze(-1)
    place = torch.where(passes, explained, -1.0).argmax(-1)
    each = torch.arange(len(place))
    best = Cascades(*(value[each, place].unsqueeze(1) for value in fitted))
    return _ranged(best, live.rows), passes.any(-1)


def _add(live: Live, best: Cascades, passed: Tensor, options: PciOptions) -> None:
    """Take what the new cascades explain out of the residuals.

    With a common refit that is what all polynomials explain together: their columns are kept
    orthonormal, so that only the new ones are looked at. Polishing moves all of them.
    """
    if not bool(passed.any()):
        return
    if options.polish:
        lagged, target, root, _ = live.rows
        before = torch.cat((live.response, torch.zeros_like(best.response)), 1)
        response = torch.cat((live.response, best.response * passed[:, None, None]), 1)
        response, residual = polish(lagged, target, root, response, options.degree, options.polish)
        live.response = torch.where(passed[:, None, None], response, before)
        live.residual = torch.where(passed[:, None], residual, live.residual)
        return
    u = live.rows.lagged @ best.response.mT
    values = basis(u, best.shift.unsqueeze(1), best.norm.unsqueeze(1)).squeeze(-2)
    values = values * (live.rows.root * passed.unsqueeze(-1)).unsqueeze(-1)
    if not options.refit:
        live.residual = live.residual - (values @ best.weight.mT).squeeze(-1)
        return
    spanned = live.spanned
    for column in values[..., 1:].unbind(-1):
        column = _outside(_outside(column.unsqueeze(-1), spanned), spanned)
        norm = torch.linalg.vector_norm(column, dim=-2, keepdim=True)
        column = torch.where(norm > DEPENDENT, column / norm.clamp(min=DEPENDENT), 0.0)
        spanned = torch.cat((spanned, column), -1)
    fresh = torch.cat((spanned[..., :1], spanned[..., live.spanned.shape[-1] :]), -1)
    fresh = fresh * passed[:, None, None]
    live.residual = _outside(live.residual.unsqueeze(-1), fresh).squeeze(-1)
    live.spanned = spanned


def _outside(columns: Tensor, spanned: Tensor) -> Tensor:
    """Return columns less their part inside what is spanned."""
    return columns - spanned @ (spanned.mT @ columns)


def _joined(built: Built, window: int, rows: Rows, options: PciOptions) -> Cascades:
    """Return the cascades of a window, their polynomials fitted together where asked."""
    depth = rows.lagged.shape[-1]
    if not built.accepted:
        none = rows.target.new_zeros(0)
        shape = none.reshape(0, options.degree)
        wide = none.reshape(0, options.degree + 1)
        return Cascades(none.reshape(0, depth), shape, shape, wide, none, none)
    if built.polished is not None:
        one = Rows(*(value[window : window + 1] for value in rows))
        model, _ = fit_cascades(
            one.lagged, one.target, one.root, built.polished[None], options.degree
        )
        model = Cascades(*(value[0] for value in _ranged(model, one)))
    else:
        model = Cascades(*(torch.cat(parts) for parts in zip(*built.accepted, strict=True)))
    return model._replace(weight=_refit(model, window, rows)) if options.refit else model


def _ranged(cascades: Cascades, rows: Rows) -> Cascades:
    """Return cascades, axes (B, K, ...), with the ranges of their linear outputs."""
    u = rows.lagged @ cascades.response.mT
    inside = (rows.root > 0).unsqueeze(-1)
    low = torch.where(inside, u, torch.inf).amin(1)
    return cascades._replace(low=low, high=torch.where(inside, u, -torch.inf).amax(1))


def _refit(model: Cascades, window: int, rows: Rows) -> Tensor:
    """Return the coefficients of all polynomials together, the shortest of the best fits."""
    values = basis(rows.lagged[window] @ model.response.T, model.shift, model.norm)
    columns = rows.root[window].unsqueeze(-1) * values.flatten(1)
    target = rows.target[window].unsqueeze(-1)
    solution = torch.linalg.lstsq(columns, target, driver="gelsd")
    weight: Tensor = solution.solution.reshape(values.shape[1:])
    return weight
