#include "policy_server/server/audit/order_audit.h"

#include <optional>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "google/protobuf/descriptor.h"
#include "google/protobuf/text_format.h"
#include "services/base/cut_text.h"

namespace rips::audit {
namespace {

// Of a larger request there is no text.
constexpr size_t kRequestBytesMax = 16 * 1024;
// Of the text of one that is refused, which costs its sender nothing.
constexpr size_t kRefusedTextBytesMax = 512;

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

}  // namespace

void OrderAudit::Record(const Order& order) {
  const std::optional<uint64_t> left_out =
      order.status.ok() ? std::optional<uint64_t>(0)
                        : refused_.Admit(absl::StrCat(order.caller, "\n", order.call));
  if (!left_out) return;
  v1::AuditRecord record;
  record.set_time_unix_ns(clock_->Now().unix_ns);
  record.set_kind(v1::AuditRecord::KIND_CALL);
  record.set_actor(order.caller);
  record.set_address(order.address);
  record.set_action(std::string(order.call));
  record.set_count(1 + *left_out);
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
  log_->Add(std::move(record));
}

}  // namespace rips::audit
