// Text in lines, with comments at their ends in columns.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_LINE_WRITER_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_LINE_WRITER_H_

#include <string>
#include <vector>

#include "absl/strings/string_view.h"

namespace rips::lang {

// Columns a line should keep to.
inline constexpr int kLineColumnsMax = 100;

// Columns count code points, from 0.
class LineWriter {
 public:
  // Beyond this nothing is indented, so that a line in deep nesting is not mostly white space.
  static constexpr int kIndentMax = 60;

  // Ends the line at hand if there is anything on it. What comes next starts in column `indent`.
  void NewLine(int indent);
  // The same unless a start has been chosen already.
  void NewLineIfNoStart(int indent);
  // One empty line before what comes next, however often it is asked for; none at the start.
  void BlankLine();

  // `text` goes on the line at hand; it may hold line ends.
  void Append(absl::string_view text);
  // Ends the line at hand with a comment; without one at hand, the comment stands under the one
  // before.
  void EndWithComment(absl::string_view comment);

  // Nothing is on the line at hand.
  bool at_start() const { return line_.empty(); }
  int column() const;

  // All of it; the last line ends too. Comments at the ends of neighbouring lines stand in one
  // column, two spaces from the longest line, where that keeps within kLineColumnsMax.
  std::string Take();

 private:
  struct Line {
    std::string text;
    std::string comment;
  };

  void Flush();
  // Lines [begin, end) all have comments.
  void PrintWithComments(size_t begin, size_t end, std::string* out) const;

  std::vector<Line> lines_;
  std::string line_;
  int column_ = 0;
  int indent_ = -1;  // -1: not chosen
  bool blank_ = false;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_LINE_WRITER_H_
