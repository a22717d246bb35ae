#include "policy_server/server/audit/order_audit.h"

#include <optional>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "google/protobuf/descriptor.h"
#include "google/protobuf/text_format.h"
#include "services/base/cut_text.h"

namespace rips::audit {
namespace {

// Of a larger request there is no text.
constexpr size_t kRequestBytesMax = 16 * 1024;
// Of the text of one that is refused, which costs its sender nothing.
constexpr size_t kRefusedTextBytesMax = 512;
constexpr absl::Duration kLeftOutWait = absl::Seconds(30);

using google::protobuf::TextFormat;

// Ids and keys as elsewhere: `request_id: 8f1a...`, instead of bytes in octal.
class HexBytes final : public TextFormat::FastFieldValuePrinter {
 public:
  void PrintBytes(const std::string& value,
                  TextFormat::BaseTextGenerator* generator) const override {
    generator->PrintString(absl::BytesToHexString(value));
  }
};

// On one line.
std::string TextOf(const google::protobuf::Message& request) {
  TextFormat::Printer printer;
  printer.SetSingleLineMode(true);
  printer.SetDefaultFieldValuePrinter(new HexBytes());  // owned by the printer
  std::string text;
  printer.PrintToString(request, &text);
  absl::StripTrailingAsciiWhitespace(&text);
  return text;
}

v1::AuditRecord RecordOf(const Order& order, int64_t unix_ns) {
  v1::AuditRecord record;
  record.set_time_unix_ns(unix_ns);
  record.set_kind(v1::AuditRecord::KIND_CALL);
  record.set_actor(order.caller);
  record.set_address(order.address);
  record.set_action(std::string(order.call));
  record.set_outcome(order.status.ok() ? "admitted" : order.status.ToString());
  if (order.request.ByteSizeLong() <= kRequestBytesMax) {
    std::string text = TextOf(order.request);
    if (!order.status.ok()) text = Shortened(text, kRefusedTextBytesMax);
    record.set_text(std::move(text));
    const auto* robot = order.request.GetDescriptor()->FindFieldByName("robot");
    if (!order.robot.empty()) {
      record.set_robot(order.robot);
    } else if (robot != nullptr) {
      record.set_robot(order.request.GetReflection()->GetString(order.request, robot));
    }
  }
  return record;
}

}  // namespace

OrderAudit::OrderAudit(AuditLog* log, const Clock* clock)
    : log_(log), clock_(clock), ticker_(kLeftOutWait, [this] {
        RecordLeftOut(absl::ToInt64Nanoseconds(kLeftOutWait));
        return kLeftOutWait;
      }) {}

OrderAudit::~OrderAudit() { RecordLeftOut(0); }

void OrderAudit::Record(const Order& order) {
  const Instant now = clock_->Now();
  uint64_t left_out = 0;
  if (!order.status.ok()) {
    const std::string kind = absl::StrCat(order.caller, "\n", order.call);
    MutexLock lock(&mu_);
    const std::optional<uint64_t> admitted = refused_.Admit(kind);
    if (!admitted) {
      const auto [it, is_first] = left_out_.try_emplace(kind);
      if (is_first) it->second = {RecordOf(order, now.unix_ns), now.boottime_ns};
      return;
    }
    left_out_.erase(kind);
    left_out = *admitted;
  }
  v1::AuditRecord record = RecordOf(order, now.unix_ns);
  record.set_count(1 + left_out);
  log_->Add(std::move(record));
}

void OrderAudit::RecordLeftOut(int64_t for_ns) {
  const int64_t until_ns = clock_->Now().boottime_ns - for_ns;
  MutexLock lock(&mu_);
  for (auto it = left_out_.begin(); it != left_out_.end();) {
    if (it->second.since_ns > until_ns) {
      ++it;
      continue;
    }
    const uint64_t count = refused_.TakeLeftOut(it->first);
    if (count > 0) {
      it->second.record.set_count(count);
      log_->Add(std::move(it->second.record));
    }
    it = left_out_.erase(it);
  }
}

}  // namespace rips::audit
