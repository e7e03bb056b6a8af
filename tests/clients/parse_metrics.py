"""Reads metrics with Prometheus' own Python parser and prints how many samples each family has, as JSON.

Usage: parse_metrics.py < METRICS, where METRICS is the text as a JSON string
"""

import json
import sys

from prometheus_client.parser import text_string_to_metric_families

families = text_string_to_metric_families(json.load(sys.stdin))
print(json.dumps({family.name: len(family.samples) for family in families}))
