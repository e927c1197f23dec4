"""Shapes, ground truth, samples: what the stages learn from and are judged by."""
