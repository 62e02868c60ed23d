"""Readers: beams, sections and stations from the files of other programs. One file for each kind of
file; `read` chooses by contents.
"""
