"""``navlearn methods``: what can stand behind ``--methods``."""

import typer


def methods() -> None:
    """List the methods that evaluate and recipes can compare, and what each may see."""
    from navlearn.recipe.fixed_methods import FIXED_METHODS
    from navlearn.recipe.spec import BUILT_IN

    lines = {name: (one.regime, one.description) for name, one in FIXED_METHODS.items()}
    lines |= {name: (spec.regime, spec.describe()) for name, spec in BUILT_IN.items()}
    widths = [max(map(len, column)) for column in (lines, [one[0] for one in lines.values()])]
    for name, (regime, description) in lines.items():
        typer.echo(f"{name:{widths[0]}}  {regime:{widths[1]}}  {description}")
    typer.echo(
        "\nnone: nothing is learned. online: learned before each outage on the drive itself.\n"
        "tuned: noise found on what is not judged. other-drives: learned there, then frozen.\n"
        "post-processing: sees fixes after the outage. oracle: knows what no method can know.\n"
        "Further models: --model SPEC.yaml, and its name among the methods."
    )
