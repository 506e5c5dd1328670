"""Pictures and figures as HTML."""

from .folder import report_folder as report_folder
from .html import write_report as write_report
