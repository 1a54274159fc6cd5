"""Capabilities: functions whose signatures state the options of commands, requests and pages."""
