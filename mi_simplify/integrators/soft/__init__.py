"""
Visibility that is soft within a radius of outlines: HardSoftRas.
"""
