"""What makes a documented run or a benchmark short: nothing that it is about."""

SHORT = [
    "optimizer.steps=2", "optimizer.batch=1", "optimizer.resolution=32", "initial.atlas_size=256",
    "evaluation.views=1", "evaluation.resolution=32", "evaluation.spp=4", "reference.spp=1", "reference.pool=2",
    "implicit.resolution=64",
]  # fmt: skip
