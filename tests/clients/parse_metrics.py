"""Reads metrics with Prometheus' own Python parser and prints how many samples each family has, as JSON.

Usage: parse_metrics.py < metrics. The strict OpenMetrics parser fails on anything not in the standard.
"""

import json
import sys

from prometheus_client.openmetrics.parser import text_string_to_metric_families

families = text_string_to_metric_families(sys.stdin.read())
print(json.dumps({family.name: len(family.samples) for family in families}))
