"""Count the skipped tests of a junit file by reason; fail if one skipped for a shared folder that was there.

Usage: python .ci/skipped.py JUNIT.xml
"""

from __future__ import annotations

import os
import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter


def main(path: str) -> int:
    """Print the counts; 1 if a test skipped for want of a shared folder that FLUXTWIN_SHARED names."""
    cases = list(ElementTree.parse(path).iter("testcase"))
    reasons = Counter(skip.get("message", "no reason given") for case in cases for skip in case.iter("skipped"))
    print(f"{len(cases)} tests, {sum(reasons.values())} skipped")
    for reason, count in reasons.most_common():
        print(f"  {count:4d}  {reason}")
    lost = sum(count for reason, count in reasons.items() if "shared folder" in reason)
    if lost and os.environ.get("FLUXTWIN_SHARED"):
        print(f"FLUXTWIN_SHARED is set, yet {lost} tests skipped for the shared folder")
        return 1
    return 0 if cases else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
