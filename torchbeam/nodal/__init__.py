"""The nodal form: local physics of elements and nodes, and the model that they make of a scene."""
