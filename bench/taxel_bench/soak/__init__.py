"""A server that is left alone under mixed traffic: does what it holds, or its latency, grow?"""
