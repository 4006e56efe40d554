"""A report says where it has no fit of a network to show."""

from collections.abc import Callable
from pathlib import Path

import pytest

from navlearn.experiment.drive import prepare_drive
from navlearn.experiment.run_chapters import run_chapters
from navlearn.outages.output import prepare_output_folder
from navlearn.recipe import Recipe

MakeRecipe = Callable[..., Recipe]


@pytest.mark.parametrize(
    ("methods", "told"),
    [
        (("ins_ekf", "jaradat2017", "ins_ekf+anarx"), ["`jaradat2017`, `ins_ekf+anarx`: no"]),
        (("ins_ekf", "ekf", "tiny"), []),
    ],
)
def test_networks_whose_solutions_were_there_already_are_named(
    make_recipe: MakeRecipe, methods: tuple[str, ...], told: list[str], tmp_path: Path
) -> None:
    recipe = make_recipe(methods=methods)
    output = prepare_output_folder(tmp_path / "run", False)
    every = run_chapters(recipe, prepare_drive(recipe), {}, output)
    chapters = [one for one in every if "Networks" in one.section[0]]
    assert len(chapters) == len(told)
    for chapter, words in zip(chapters, told, strict=True):
        assert words in chapter.section[1]
        assert "--force" in chapter.section[1]
