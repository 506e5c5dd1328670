"""Metrics, pictures and the HTML report."""

from .evaluate import Comparison as Comparison
from .evaluate import compare_assets as compare_assets
from .evaluate import evaluate as evaluate
from .evaluate import save_comparison as save_comparison
from .folder import report_folder as report_folder
from .html import write_report as write_report
