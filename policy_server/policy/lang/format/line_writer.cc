#include "policy_server/policy/lang/format/line_writer.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

// Spaces before a comment at the end of a line.
constexpr int kCommentGap = 2;

int Columns(absl::string_view text) {
  const size_t line_end = text.rfind('\n');
  if (line_end != absl::string_view::npos) text.remove_prefix(line_end + 1);
  return static_cast<int>(CountCodePoints(text));
}

}  // namespace

void LineWriter::NewLine(int indent) {
  if (!line_.empty()) Flush();
  indent_ = std::min(indent, kIndentMax);
}

void LineWriter::NewLineIfNoStart(int indent) {
  if (!line_.empty() || indent_ < 0) NewLine(indent);
}

void LineWriter::BlankLine() {
  if (!line_.empty()) Flush();
  blank_ = !lines_.empty();
}

void LineWriter::Append(absl::string_view text) {
  if (line_.empty()) {
    if (blank_) lines_.emplace_back();
    blank_ = false;
    column_ = std::max(indent_, 0);
    line_.assign(column_, ' ');
  }
  line_.append(text.data(), text.size());
  const bool line_ends = text.find('\n') != absl::string_view::npos;
  column_ = (line_ends ? 0 : column_) + Columns(text);
}

void LineWriter::EndWithComment(absl::string_view comment) {
  lines_.push_back({.text = std::exchange(line_, ""), .comment = std::string(comment)});
  indent_ = -1;
}

int LineWriter::column() const { return line_.empty() ? std::max(indent_, 0) : column_; }

void LineWriter::Flush() {
  lines_.push_back({.text = std::exchange(line_, ""), .comment = ""});
  indent_ = -1;
}

void LineWriter::PrintWithComments(size_t begin, size_t end, std::string* out) const {
  int common = 0;
  int longest = 0;
  for (size_t i = begin; i < end; ++i) {
    common = std::max(common, Columns(lines_[i].text) + kCommentGap);
    longest = std::max(longest, Columns(lines_[i].comment));
  }
  const bool aligned = common + longest <= kLineColumnsMax;
  int column = common;
  for (size_t i = begin; i < end; ++i) {
    const int columns = Columns(lines_[i].text);
    // An empty line keeps the column of the comment that it continues.
    if (!aligned && !lines_[i].text.empty()) column = columns + kCommentGap;
    absl::StrAppend(out, lines_[i].text, std::string(column - columns, ' '), lines_[i].comment,
                    "\n");
  }
}

std::string LineWriter::Take() {
  if (!line_.empty()) Flush();
  std::string out;
  for (size_t i = 0; i < lines_.size();) {
    size_t end = i;
    while (end < lines_.size() && !lines_[end].comment.empty()) ++end;
    if (end > i) {
      PrintWithComments(i, end, &out);
      i = end;
    } else {
      absl::StrAppend(&out, lines_[i].text, "\n");
      ++i;
    }
  }
  lines_.clear();
  return out;
}

}  // namespace rips::lang
