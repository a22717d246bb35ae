"""Tests of class_sizes.py and of how tidy_test.py compares its counts with the list."""

import pathlib
import sys
import unittest

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from class_sizes import class_sizes  # noqa: E402
from tidy_test import class_breaches  # noqa: E402

SOURCE = """
enum class E { a, b };
class A final : public B<int> {
 public:
  explicit A(int a) : a_{a}, b_(2) {}
  A(const A&) = delete;
  ~A() override;
  static constexpr int kMax = 3;
  using T = int;
  struct In { int x = 0; int y; };
  int Get() const { if (a_) { return 1; } return 0; }
  virtual void F() = 0;
  std::function<void()> f = [] { return; };
 private:
  friend class C;
  int a_ = 1, b_{};
  In in_{.x = 1};  // a comment; with { brace
  std::string s_ = "};{";
};
"""


class ClassSizesTest(unittest.TestCase):
    def test_counts_members_and_methods(self):
        self.assertEqual(list(class_sizes(SOURCE)), [("A", 3, 8), ("In", 10, 2)])

    def test_a_class_that_is_not_listed_has_at_most_25(self):
        self.assertEqual(list(class_breaches({("a.h", "A"): 25}, {})), [])
        self.assertEqual(len(list(class_breaches({("a.h", "A"): 26}, {}))), 1)

    def test_the_list_only_shrinks(self):
        listed = {("a.h", "A"): 40}
        self.assertEqual(list(class_breaches({("a.h", "A"): 40}, listed)), [])
        for size in (39, 41):
            self.assertEqual(len(list(class_breaches({("a.h", "A"): size}, listed))), 1)
        self.assertEqual(len(list(class_breaches({}, listed))), 1)


if __name__ == "__main__":
    unittest.main()
