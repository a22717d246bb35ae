// `ripsctl audit`: a policy server's audit log, verified and read from its files.
#include <CLI/CLI.hpp>
#include <cstdint>
#include <deque>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/audit/verify.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "rips/v1/audit.pb.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

using v1::AuditRecord;

std::string KindName(AuditRecord::Kind kind) {
  return EnumText(AuditRecord::Kind_Name(kind), "KIND_", "unknown");
}

// {"sequence","time","kind","robot","id","actor","address","action","from","to","decision_id",
//  "based_on","text","outcome","count"}
Json RecordJson(uint64_t sequence, const AuditRecord& record) {
  const auto decision_id = [](bool has, const v1::DecisionId& value) {
    return has ? Json(DecisionIdText(value)) : Json(nullptr);
  };
  return {{"sequence", sequence},
          {"time", FullTime(record.time_unix_ns())},
          {"kind", KindName(record.kind())},
          {"robot", record.robot()},
          {"id", record.id()},
          {"actor", record.actor()},
          {"address", record.address()},
          {"action", record.action()},
          {"from", record.from()},
          {"to", record.to()},
          {"decision_id", decision_id(record.has_decision_id(), record.decision_id())},
          {"based_on", decision_id(record.has_based_on(), record.based_on())},
          {"text", record.text()},
          {"outcome", record.outcome()},
          {"count", record.count()}};
}

// What a record says, in one line.
std::string Words(const AuditRecord& record) {
  std::string words;
  if (!record.action().empty()) words = absl::StrCat(record.action(), " ", record.outcome());
  if (record.kind() == AuditRecord::KIND_ACK) {
    words = absl::StrCat("acknowledged alert ", record.id(), " of ", record.action(), " (",
                         record.outcome(), ")");
  }
  if (!record.to().empty()) {
    words = absl::StrCat(record.kind() == AuditRecord::KIND_REFUSAL ? "refused " : "",
                         record.from(), " to ", record.to());
    if (record.has_decision_id())
      absl::StrAppend(&words, " (", DecisionIdText(record.decision_id()), ")");
  }
  if (!record.text().empty()) absl::StrAppend(&words, words.empty() ? "" : ": ", record.text());
  if (record.count() > 1) absl::StrAppend(&words, " (", record.count(), " times)");
  return words;
}

std::string Place(const audit::Fault& fault) {
  if (fault.file.empty()) return "";
  return absl::StrCat(EscapeText(fault.file), ", byte ", fault.offset, ": ");
}

// On env.err what is wrong with the log, if anything is.
ExitCode Judge(const audit::Report& report, Env& env) {
  if (!report.fault) return ExitCode::kDone;
  const audit::Fault& fault = *report.fault;
  env.err << "error: the log is " << audit::KindName(fault.kind) << ": " << Place(fault)
          << EscapeText(fault.text) << "\n       record " << fault.sequence
          << " is the first in doubt";
  if (report.records > 0) env.err << "; " << report.records << " before it are proven by a seal";
  env.err << "\n";
  return ExitCode::kRefused;
}

Json ReportJson(const audit::Report& report) {
  Json json = {
      {"whole", !report.fault},
      {"segments", report.segments},
      {"records", report.records},
      {"identity", absl::BytesToHexString(report.identity)},
      {"head", report.head.sequence == 0 ? Json(nullptr) : Json(audit::FormatHead(report.head))},
      {"fault", nullptr},
      {"torn", Json::array()}};
  for (const audit::Torn& torn : report.torn) {
    json["torn"].push_back({{"file", torn.file}, {"offset", torn.offset}, {"bytes", torn.bytes}});
  }
  if (report.fault) {
    json["fault"] = {{"kind", audit::KindName(report.fault->kind)},
                     {"file", report.fault->file},
                     {"offset", report.fault->offset},
                     {"sequence", report.fault->sequence},
                     {"text", report.fault->text}};
  }
  return json;
}

class AuditCommand : public Command {
 public:
  using Command::Command;
  void AddFlags(CLI::App& app) override {
    app.add_option("DIRECTORY", directory_, "The server's `audit: {dir: ...}`, or a copy of it")
        ->required();
  }

 protected:
  // NotFound if the directory has no log.
  absl::StatusOr<audit::Report> Verify(absl::Span<const audit::Head> heads,
                                       audit::Visit visit) const {
    RIPS_ASSIGN_OR_RETURN(audit::Report report,
                          audit::Verify(audit::SegmentsInDirectory(directory_), heads, visit));
    if (report.segments > 0 || report.fault) return report;
    return absl::NotFoundError(absl::StrCat("`", directory_, "` holds no audit log"));
  }

 private:
  std::string directory_;
};

class VerifyAudit final : public AuditCommand {
 public:
  VerifyAudit()
      : AuditCommand({"audit", "verify",
                      "Verify that an audit log is complete and unaltered, or show its first fault",
                      /*needs_server=*/false}) {}
  void AddFlags(CLI::App& app) override {
    AuditCommand::AddFlags(app);
    app.add_option("--head", heads_,
                   "A head that the log had before, as this command printed it; may be repeated")
        ->allow_extra_args(false);
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    std::vector<audit::Head> heads;
    for (const std::string& text : heads_) {
      const absl::StatusOr<audit::Head> head = audit::ParseHead(text);
      if (!head.ok()) return UsageError(env, head.status().message());
      heads.push_back(*head);
    }
    const auto report = Verify(heads, [](uint64_t, absl::string_view) {});
    if (!report.ok()) return UsageError(env, report.status().message());
    if (env.json()) {
      PrintJson(ReportJson(*report), env.out);
      return report->fault ? ExitCode::kRefused : ExitCode::kDone;
    }
    for (const audit::Torn& torn : report->torn) {
      env.out << "note: " << EscapeText(torn.file) << ", byte " << torn.offset << ": " << torn.bytes
              << " bytes were being written at a crash; they do not belong to the log\n";
    }
    if (report->fault) return Judge(*report, env);
    env.out << "The log is whole: " << report->records << " records in " << report->segments
            << (report->segments == 1 ? " segment" : " segments") << ".\n  log   "
            << absl::BytesToHexString(report->identity) << "\n  head  "
            << audit::FormatHead(report->head)
            << "\nKeep the head elsewhere; `--head` verifies later that no record was removed.\n";
    return ExitCode::kDone;
  }

 private:
  std::vector<std::string> heads_;
};

class TailAudit final : public AuditCommand {
 public:
  TailAudit()
      : AuditCommand(
            {"audit", "tail", "Show the newest records, oldest first", /*needs_server=*/false}) {}
  void AddFlags(CLI::App& app) override {
    AuditCommand::AddFlags(app);
    app.add_option("--limit", limit_, "Maximum number of entries")->check(CLI::Range(1, 100'000));
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    std::deque<std::pair<uint64_t, AuditRecord>> newest;
    const auto report = Verify({}, [&](uint64_t sequence, absl::string_view payload) {
      if (newest.size() == limit_) newest.pop_front();
      newest.emplace_back(sequence, AuditRecord());
      newest.back().second.ParseFromArray(payload.data(), static_cast<int>(payload.size()));
    });
    if (!report.ok()) return UsageError(env, report.status().message());
    Table table({"RECORD", "TIME", "KIND", "ROBOT", "BY", "WHAT"});
    Json all = Json::array();
    for (const auto& [sequence, record] : newest) {
      if (env.json()) {
        all.push_back(RecordJson(sequence, record));
      } else {
        table.Add({absl::StrCat(sequence), ShortTime(record.time_unix_ns()),
                   KindName(record.kind()), record.robot(), record.actor(), Words(record)});
      }
    }
    if (env.json()) {
      PrintJson({{"records", all}, {"log", ReportJson(*report)}}, env.out);
    } else {
      table.Print(env.out);
    }
    return Judge(*report, env);
  }

 private:
  size_t limit_ = 20;
};

class ExportAudit final : public AuditCommand {
 public:
  ExportAudit()
      : AuditCommand({"audit", "export",
                      "Print all records as JSON, one a line, up to the first fault",
                      /*needs_server=*/false}) {}
  absl::StatusOr<ExitCode> Run(Env& env) override {
    const auto report = Verify({}, [&](uint64_t sequence, absl::string_view payload) {
      if (!env.out.ok()) return;
      AuditRecord record;
      record.ParseFromArray(payload.data(), static_cast<int>(payload.size()));
      PrintJson(RecordJson(sequence, record), env.out);
    });
    if (!report.ok()) return UsageError(env, report.status().message());
    return Judge(*report, env);
  }
};

}  // namespace

Commands AuditCommands() { return MakeCommands<VerifyAudit, TailAudit, ExportAudit>(); }

}  // namespace rips::ripsctl
