"""Texts of the licences for releases."""

from gym_open.datasets.config import Header

URLS = {
    "mit": "https://spdx.org/licenses/MIT.html",
    "cc-by-4.0": "https://creativecommons.org/licenses/by/4.0/",
    "cc0-1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
}
"""Address of each licence, by which machines recognise it."""
_MIT = """\
MIT License

Copyright (c) {who}

Permission is hereby granted, free of charge, to any person obtaining a copy
of this data set and associated documentation files (the "Software"), to deal
in the Software without restriction, including without limitation the rights
to use, copy, modify, merge, publish, distribute, sublicense, and/or sell
copies of the Software, and to permit persons to whom the Software is
furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.
"""
_CC_BY = """\
Copyright (c) {who}

This data set is licensed under the Creative Commons Attribution 4.0
International License (CC BY 4.0): you may share and adapt it for any purpose,
also commercially, if you give appropriate credit, link to the licence and say
what you changed. It comes without warranty.

The licence itself: https://creativecommons.org/licenses/by/4.0/legalcode
"""
_CC0 = """\
To the extent possible under law, {who} have waived all copyright and related
or neighbouring rights to this data set: CC0 1.0 Universal (CC0 1.0), Public
Domain Dedication. It comes without warranty.

The dedication itself: https://creativecommons.org/publicdomain/zero/1.0/legalcode
"""
_TEXTS = {"mit": _MIT, "cc-by-4.0": _CC_BY, "cc0-1.0": _CC0}


def licence_text(header: Header) -> str:
    """Text of LICENSE: the full text for MIT, else a notice with the address. It does not depend on the year."""
    return _TEXTS[header.license].format(who=f"the authors of {header.name}")
