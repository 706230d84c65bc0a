"""The examination of a scan before a map is built from it: do its pictures, depth and poses agree?"""
