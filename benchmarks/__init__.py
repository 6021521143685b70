"""How fast the environment is, beside the least it could cost and beside its neighbours."""

import os

# crazyflow refuses to load unless this was set before SciPy was first imported.
os.environ.setdefault("SCIPY_ARRAY_API", "1")
