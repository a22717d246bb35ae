"""tests/previous in repositories of a few files, where `deploy/build` only says how it was called:
which commit it takes, and that it refuses what it cannot build, or should not touch.
"""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

SCRIPT = pathlib.Path(__file__).resolve().parents[1] / "previous"
SAID = "RIPS_PREVIOUS_BIN={tree}/build/release/bin ctest --test-dir build/release -R skew"


class PreviousTest(unittest.TestCase):
    def setUp(self):
        self.directory = tempfile.TemporaryDirectory()
        self.addCleanup(self.directory.cleanup)
        parent = pathlib.Path(self.directory.name).resolve()
        self.root = parent / "clone"
        self.env = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
        self.env.update(GIT_CONFIG_GLOBAL=os.devnull, GIT_CEILING_DIRECTORIES=str(parent))
        for who in ("AUTHOR", "COMMITTER"):
            self.env.update({f"GIT_{who}_NAME": "a", f"GIT_{who}_EMAIL": "a@example.org"})
        self.root.mkdir()
        self.git("init", "--quiet")
        self.write(".gitignore", "/build/\n")
        self.write("CMakeLists.txt", "rips_binary(NAME rips-sensor SRCS main.cc)\n")
        self.write("deploy/build", "#!/bin/sh\necho built \"$@\" in $(cat \"${0%/*}/number\")\n")
        (self.root / "deploy/build").chmod(0o755)
        (self.root / "tests").mkdir()
        shutil.copy(SCRIPT, self.root / "tests/previous")
        self.tree = self.root / "build/previous"

    def write(self, name, text):
        (self.root / name).parent.mkdir(parents=True, exist_ok=True)
        (self.root / name).write_text(text)

    def git(self, *args):
        return subprocess.run(["git", *args], cwd=self.root, env=self.env, check=True,
                              capture_output=True, text=True).stdout.strip()

    def commit(self, number, version=None):
        self.write("deploy/number", f"{number}\n")
        if version:
            self.write("deploy/debian/changelog", f"rips ({version}) bookworm; urgency=low\n")
        self.git("add", "--all")
        self.git("commit", "--quiet", "--message", f"commit {number}")

    def run_script(self, *args, root=None):
        return subprocess.run([(root or self.root) / "tests/previous", *args], env=self.env,
                              capture_output=True, text=True)

    def builds(self, number, *args, why=""):
        done = self.run_script(*args)
        self.assertEqual(done.returncode, 0, done.stderr)
        first, built, last = done.stdout.splitlines()
        self.assertIn(f"(commit {number}){why}", first)
        self.assertEqual(built, f"built release rips-sensor in {number}")
        self.assertEqual(last, SAID.format(tree=self.tree))

    def refuses(self, code, text, *args, root=None):
        done = self.run_script(*args, root=root)
        self.assertEqual(done.returncode, code, done.stdout + done.stderr)
        self.assertIn(f"error: {text}", done.stderr)
        self.assertEqual(self.git("status", "--porcelain"), "")

    def test_takes_the_newest_commit_of_another_version(self):
        for number, version in enumerate(["0.1.0", None, "0.2.0", None, "0.3.0", None]):
            self.commit(number, version)
        self.builds(3, why=", the newest of version 0.2.0")
        self.write("deploy/debian/changelog", "rips (0.4.0) bookworm; urgency=low\n")
        self.builds(5, why=", the newest of version 0.3.0")

    def test_another_entry_of_the_same_version_is_none(self):
        self.commit(0, "0.1.0")
        self.commit(1, "0.2.0")
        self.write("deploy/debian/changelog", "rips (0.2.0) bookworm; urgency=high\n")
        self.commit(2)
        self.builds(0, why=", the newest of version 0.1.0")

    def test_goes_20_back_where_all_have_one_version(self):
        self.commit(0)
        self.commit(1, "0.1.0")
        for number in range(2, 21):
            self.commit(number)
        self.builds(0, why=", 20 before HEAD")
        self.commit(21)
        self.builds(1, why=", 20 before HEAD")

    def test_takes_what_it_is_told_and_uses_its_worktree_again(self):
        for number in range(3):
            self.commit(number, "0.1.0")
        self.git("tag", "--annotate", "--message", "x", "first", "HEAD~2")
        self.builds(0, "first")
        self.builds(1, "HEAD~1")
        self.assertEqual(self.git("status", "--porcelain"), "")
        self.assertIn("commit 2", self.git("log", "-1"))
        shutil.rmtree(self.root / "build")
        self.builds(0, self.git("rev-parse", "HEAD~2"))

    def test_refuses_arguments(self):
        self.commit(0, "0.1.0")
        self.refuses(2, "unknown option --rev", "--rev")
        self.refuses(2, "more than one commit", "HEAD", "HEAD")
        for name in ("nothing", "", "HEAD~1", "HEAD:deploy", "a b"):
            self.refuses(1, f"there is no commit `{name}`\n", name)
        self.assertIn("tests/previous REV", self.run_script("--help").stdout)
        self.assertFalse(self.tree.exists())

    def test_refuses_a_history_that_is_too_short(self):
        self.commit(0, "0.1.0")
        self.refuses(1, "there is no commit 20 before HEAD; name one")

    def test_a_shallow_clone_is_told_how_to_get_the_rest(self):
        for number in range(30):
            self.commit(number, "0.1.0")
        clone = self.root.parent / "shallow"
        self.git("clone", "--quiet", "--depth", "25", f"file://{self.root}", str(clone))
        missing = "in this shallow clone; git fetch --unshallow gets the others"
        self.refuses(1, f"there is no other version {missing}", root=clone)
        self.refuses(1, f"there is no commit `HEAD~26` {missing}", "HEAD~26", root=clone)
        self.assertEqual(self.run_script("HEAD~2", root=clone).returncode, 0)

    def test_refuses_a_directory_that_is_no_worktree(self):
        self.commit(0, "0.1.0")
        self.commit(1)
        self.write("build/previous/precious", "x")
        self.refuses(1, "build/previous is no git worktree", "HEAD~1")
        self.assertEqual((self.root / "deploy/number").read_text(), "1\n")

    def test_refuses_a_worktree_with_changes(self):
        self.commit(0, "0.1.0")
        self.commit(1)
        self.builds(0, "HEAD~1")
        (self.tree / "deploy/number").write_text("2\n")
        self.refuses(1, "build/previous has changed files", "HEAD")
        self.assertEqual((self.tree / "deploy/number").read_text(), "2\n")

    def test_refuses_a_tree_without_git(self):
        self.commit(0, "0.1.0")
        (self.root / ".git").rename(self.root.parent / "away")
        done = self.run_script()
        self.assertEqual(done.returncode, 1)
        self.assertIn(f"error: {self.root} is no git clone", done.stderr)

    def test_ends_as_the_build_does(self):
        self.commit(0, "0.1.0")
        self.write("CMakeLists.txt", "# nothing\n")
        self.commit(1)
        self.refuses(1, "that commit has none of rips-policy-server", "HEAD")
        self.write("CMakeLists.txt", "rips_binary(NAME ripsctl SRCS main.cc)\n")
        self.write("deploy/build", "#!/bin/sh\nexit 3\n")
        self.commit(2)
        done = self.run_script("HEAD")
        self.assertEqual(done.returncode, 3)
        self.assertNotIn("RIPS_PREVIOUS_BIN", done.stdout)


if __name__ == "__main__":
    if not shutil.which("git"):
        print("skipped: there is no git")
        sys.exit(77)
    unittest.main()
