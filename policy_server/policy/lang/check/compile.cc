#include "policy_server/policy/lang/check/compile.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/check/checker.h"
#include "policy_server/policy/lang/diagnostic/diagnostic_sink.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/limits.h"
#include "policy_server/policy/lang/syntax/lexer.h"
#include "policy_server/policy/lang/syntax/parser.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

// False if the file is refused as a whole.
bool CheckText(uint32_t file, absl::string_view text, DiagnosticSink& sink) {
  if (text.size() > kFileBytesMax) {
    sink.Add(DiagnosticKind::kFileTooLarge, {.file = file},
             absl::StrCat("a file of ", text.size(), " bytes exceeds limit ", kFileBytesMax),
             "split the policy");
    return false;
  }
  if (const std::optional<size_t> bad = FindInvalidUtf8(text)) {
    sink.Add(DiagnosticKind::kInvalidUtf8,
             {.file = file, .offset = static_cast<uint32_t>(*bad), .length = 1},
             absl::StrCat("the file is not UTF-8 at byte offset ", *bad), "save it as UTF-8");
    return false;
  }
  return true;
}

// One file from text to tree. The lexer and the parser each go through it in order, so each has a
// list of its own: a full one has lost only what would not be shown.
class Reader {
 public:
  // None if the file is refused as a whole.
  std::optional<ast::File> Read(uint32_t file, absl::string_view text) {
    if (!CheckText(file, text, words_)) return std::nullopt;
    const Source source(file, text);
    const std::vector<Token> tokens = Lex(source, words_);
    if (tokens.size() == 1) {
      words_.Add(DiagnosticKind::kEmptyFile, {.file = file, .offset = source.start()},
                 "the file declares nothing");
    }
    return Parse(source, tokens, grammar_);
  }

  bool has_errors() const { return words_.has_errors() || grammar_.has_errors(); }
  bool is_empty() const { return words_.diagnostics().empty() && grammar_.diagnostics().empty(); }

  void AppendTo(std::vector<Diagnostic>& out) const {
    for (const DiagnosticSink* sink : {&words_, &grammar_}) {
      out.insert(out.end(), sink->diagnostics().begin(), sink->diagnostics().end());
    }
  }

 private:
  DiagnosticSink words_;
  DiagnosticSink grammar_;
};

bool HasRules(const std::vector<ast::File>& trees) {
  for (const ast::File& tree : trees) {
    for (const ast::Section& section : tree.sections) {
      if (!section.rules.empty()) return true;
    }
  }
  return false;
}

// Where the rule stands and what its condition says.
void AddText(const std::vector<SourceFile>& files, TypedRule& rule) {
  const SourceFile& file = files[rule.range.file];
  const absl::string_view path = file.path;
  const Source source(rule.range.file, file.text);
  rule.place = absl::StrCat(path.substr(path.rfind('/') + 1), ":",
                            source.PositionOf(rule.range.offset).line);
  rule.condition_text = std::string(source.Text(rule.condition.range));
}

bool HasErrors(const std::vector<Diagnostic>& diagnostics) {
  return std::any_of(diagnostics.begin(), diagnostics.end(), [](const Diagnostic& diagnostic) {
    return SeverityOf(diagnostic.kind) == DiagnosticSeverity::kError;
  });
}

}  // namespace

CompileResult Compile(const std::vector<SourceFile>& files, const CompileOptions& options) {
  Reader reader;
  DiagnosticSink meaning;
  std::vector<ast::File> trees;
  bool all_read = true;
  size_t nodes = 0;
  for (uint32_t i = 0; i < files.size(); ++i) {
    std::optional<ast::File> tree = reader.Read(i, files[i].text);
    // What stands after a file that was not read may need its names, so it is not judged.
    all_read = all_read && tree.has_value();
    if (!all_read) continue;
    nodes += tree->nodes;
    if (nodes > kProgramNodesMax && tree->nodes <= kProgramNodesMax) {
      meaning.Add(DiagnosticKind::kProgramTooLarge, {.file = i},
                  absl::StrCat("more than ", kProgramNodesMax,
                               " operators and operands, with the files before"),
                  "split the policy");
      all_read = false;
      continue;
    }
    trees.push_back(std::move(*tree));
  }
  const Syntax syntax = reader.has_errors() || !all_read ? Syntax::kBroken : Syntax::kClean;
  std::vector<std::string> paths;
  for (const SourceFile& file : files) paths.push_back(file.path);
  CheckedRules rules = Check({.files = trees,
                              .paths = paths,
                              .dialect = options.dialect,
                              .syntax = syntax,
                              .inspection_files = options.inspection_files},
                             meaning);
  if (syntax == Syntax::kClean && reader.is_empty() && !files.empty() && !HasRules(trees)) {
    meaning.Add(DiagnosticKind::kNoRules, {.file = static_cast<uint32_t>(files.size() - 1)},
                "there are no rules");
  }

  CompileResult out;
  reader.AppendTo(out.diagnostics);
  out.diagnostics.insert(out.diagnostics.end(), meaning.diagnostics().begin(),
                         meaning.diagnostics().end());
  if (!HasErrors(out.diagnostics)) {
    for (TypedRule& rule : rules.rules) AddText(files, rule);
    out.rules = std::move(rules);
  }
  out.diagnostics = SortAndCut(std::move(out.diagnostics));
  return out;
}

}  // namespace rips::lang
