"""
Faces: morphable models fitted to portraits.
"""
