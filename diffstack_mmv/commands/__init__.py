"""What the command lines are made of: composed and checked configurations, failures, jobs.

Only `scripts/` imports from here. Nothing is imported by this file, so that a mistake is told
before anything heavy is.
"""
