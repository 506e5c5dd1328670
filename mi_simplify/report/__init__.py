"""Metrics, pictures and the HTML report."""

from .comparison import Comparison as Comparison
from .comparison import save_comparison as save_comparison
from .evaluate import compare_assets as compare_assets
from .evaluate import evaluate as evaluate
from .folder import report_folder as report_folder
from .html import write_report as write_report
