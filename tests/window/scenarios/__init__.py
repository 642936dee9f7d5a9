# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenarios, by what they are about."""
