"""Predictors that run without navlearn: TorchScript now, torch.export as its successor."""

from navlearn.export.metadata import PredictorMetadata, describe
from navlearn.export.reading import LoadedPredictor, load_predictor
from navlearn.export.replay import predict_drive
from navlearn.export.writing import ExportReport, export_predictor

__all__ = [
    "ExportReport",
    "LoadedPredictor",
    "PredictorMetadata",
    "describe",
    "export_predictor",
    "load_predictor",
    "predict_drive",
]
