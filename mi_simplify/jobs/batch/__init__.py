"""
Many assets, one after another or many at once, on one machine or a cluster.
"""
