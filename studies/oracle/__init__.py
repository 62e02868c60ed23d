"""An independent oracle: rods described once, solved by the library and by a dense reference that
shares no line with it.
"""
