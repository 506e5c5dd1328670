"""
What is simplified, whatever it is: a job asks a subject for a first guess, for images, and for a verdict.
"""

from .opening import open_subject as open_subject
from .subject import Subject as Subject
from .subject import open_asset as open_asset
