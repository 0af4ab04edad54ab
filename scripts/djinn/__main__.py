"""`python -m djinn …` is `djinn …`: the program that was installed with this package, or the one on the path."""

import os
import shutil
import subprocess
import sys
import sysconfig

found = shutil.which("djinn", path=sysconfig.get_path("scripts")) or shutil.which("djinn")
if found is None:
    sys.exit("the program djinn is neither installed beside this package nor on the path: pip install djinn-traffic")
if os.name == "posix":
    os.execv(found, ["djinn", *sys.argv[1:]])
sys.exit(subprocess.call([found, *sys.argv[1:]]))
