"""Inner loops compiled by numba: half-edges, collapses, energies, relaxation.

They take plain arrays and check nothing; `gensp.geometry` is what calls them. Compilation takes
some seconds once, and is kept on disk.
"""
