# Adds its shared library to HOST_LIBRARIES.
