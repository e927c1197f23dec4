"""Which mesh files are read, and how large they may be; needs nothing but itself."""

FORMATS = (".ply", ".obj", ".off", ".stl")
MAX_FACES = 200_000  # larger meshes are refused unless asked for
