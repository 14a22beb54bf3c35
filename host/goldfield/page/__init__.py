"""The live page: a sensor's poses and the health of its beacons in a browser, served by this host itself.

`feeding` turns what a sensor yields into messages, `hub` hands them to every browser that looks, `application` answers
the browsers, and `serving` runs it at an address. The page's sources are in ``web``; ``make page`` builds them.
"""
