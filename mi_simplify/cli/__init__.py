"""
The command line: parse, call the functions that Python users call, say what came out.

The only package that prints. Exit codes: 0 done, 2 the user's input is wrong (one line, no traceback), 1 a defect of
ours, 130 interrupted. Nothing heavy is imported before a command runs.
"""

from .program import main as main
