"""What is measured: images against images, files against models."""

from .comparison import Comparison as Comparison
from .comparison import save_comparison as save_comparison
from .evaluate import compare_assets as compare_assets
from .evaluate import evaluate as evaluate
