// Golden rule files: the input and what the compiler says about it, in one file.
//
// The expectation is the run of lines at the end of the file that start with `#=`:
//
//   #= 5:15 error DivisionByZero: division by zero
//   #=   hint: ...
//   #= accepted            (or: refused)
//
// RIPS_UPDATE_GOLDENS=1 rewrites the expectations of all files; the diff is to be reviewed.
#ifndef RIPS_TESTS_GOLDEN_GOLDEN_FILE_H_
#define RIPS_TESTS_GOLDEN_GOLDEN_FILE_H_

#include <string>
#include <vector>

namespace rips::golden {

struct GoldenFile {
  std::string path;
  // The part before the expectation; what is compiled.
  std::string input;
  std::string expected;
};

// Every *.rul beside this header, by name.
std::vector<GoldenFile> LoadGoldenFiles();

}  // namespace rips::golden

#endif  // RIPS_TESTS_GOLDEN_GOLDEN_FILE_H_
