"""What is looked at and from where: assets, reference renderers, views, samples."""
