"""Runs the quality checkers that ASAM publishes for its standards."""

import logging
from collections import Counter


def demand_clean(checker, files):
    """Demands that a checker, the module `main` of its package, finds nothing in these files and made at least one of its checks of each."""
    from qc_baselib import Configuration, Result, StatusType

    logging.disable(logging.CRITICAL)  # the checkers tell of every step
    n_made = Counter()
    for file in files:
        config, result = Configuration(), Result()
        config.set_config_param("InputFile", str(file))
        bundle, version = checker.constants.BUNDLE_NAME, checker.constants.BUNDLE_VERSION
        result.register_checker_bundle(name=bundle, description="", version=version, summary="")
        result.set_result_version(version=version)
        checker.run_checks(config, result)
        names = result.get_checker_ids(bundle)
        made, failed = ([n for n in names if result.get_checker_status(n) == status] for status in (StatusType.COMPLETED, StatusType.ERROR))
        found = Counter(issue.description for name in made for issue in result.get_issues(bundle, name))
        assert made and not failed, f"{file}: {failed or 'no check'} could be made"
        assert not found, f"{file}: {dict(found)}"
        n_made.update(made)
    logging.disable(logging.NOTSET)
    return len(n_made)
