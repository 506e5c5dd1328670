"""
A morphable face fitted to portraits: landmarks first, then everything at once.
"""
