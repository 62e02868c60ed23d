"""Compiled engine: functions of small tensors traced to scalar operations, differentiated, and run
as native code.
"""
