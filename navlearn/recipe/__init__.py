"""Recipes and specs: the YAML of ``training/`` and ``models/`` as typed objects."""

from navlearn.recipe.anarx_spec import AnarxSpec
from navlearn.recipe.document import Recipe, load_recipe, recipe_for
from navlearn.recipe.spec import ModelSpec, load_spec

__all__ = ["AnarxSpec", "ModelSpec", "Recipe", "load_recipe", "load_spec", "recipe_for"]
