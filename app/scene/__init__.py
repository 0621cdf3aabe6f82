"""The laws of a case with their places, and the bodies they act on. Begin with `build`."""
