#include "services/ros2/ros_name.h"

#include "absl/status/status.h"
#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/strip.h"

namespace rips::ros2 {
namespace {

constexpr absl::string_view kTypeNamespace = "dds_::";

bool IsTokenStart(char c) { return absl::ascii_isalpha(c) || c == '_'; }
bool IsTokenChar(char c) { return absl::ascii_isalnum(c) || c == '_'; }

// "[A-Za-z_][A-Za-z0-9_]*"
bool IsToken(absl::string_view text) {
  if (text.empty() || !IsTokenStart(text[0])) return false;
  for (char c : text) {
    if (!IsTokenChar(c)) return false;
  }
  return true;
}

absl::Status ValidateName(absl::string_view what, absl::string_view name) {
  if (name.size() > kRosNameBytesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat(what, " of ", name.size(), " bytes exceeds limit ", kRosNameBytesMax));
  }
  absl::string_view rest = name;
  bool valid = absl::ConsumePrefix(&rest, "/");
  while (valid) {
    const size_t slash = rest.find('/');
    valid = IsToken(rest.substr(0, slash));
    if (slash == absl::string_view::npos) break;
    rest.remove_prefix(slash + 1);
  }
  if (valid) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("`", Printable(name), "` is not a valid ", what,
                   "; expected /token/token of letters, digits and underscores"));
}

// The "/s" of "<prefix>/s<suffix>"; empty if `dds_topic` has another form.
absl::string_view Unwrap(absl::string_view dds_topic, absl::string_view prefix,
                         absl::string_view suffix) {
  if (!absl::ConsumePrefix(&dds_topic, prefix) || !absl::ConsumeSuffix(&dds_topic, suffix) ||
      !ValidateTopicName(dds_topic).ok()) {
    return {};
  }
  return dds_topic;
}

std::string MangleTypeWith(absl::string_view type, absl::string_view suffix) {
  const size_t slash = type.rfind('/');
  const size_t base = slash == absl::string_view::npos ? 0 : slash + 1;
  return absl::StrCat(absl::StrReplaceAll(type.substr(0, base), {{"/", "::"}}), kTypeNamespace,
                      type.substr(base), suffix);
}

}  // namespace

DemangledTopic DemangleTopic(absl::string_view dds_topic) {
  struct Form {
    DdsTopicKind kind;
    absl::string_view prefix;
    absl::string_view suffix;
  };
  constexpr Form kForms[] = {{DdsTopicKind::kTopic, "rt", ""},
                             {DdsTopicKind::kServiceRequest, "rq", "Request"},
                             {DdsTopicKind::kServiceReply, "rr", "Reply"}};
  for (const Form& form : kForms) {
    const absl::string_view name = Unwrap(dds_topic, form.prefix, form.suffix);
    if (!name.empty()) return {form.kind, std::string(name)};
  }
  return {DdsTopicKind::kOther, Printable(dds_topic)};
}

std::string DemangleType(absl::string_view dds_type) {
  const std::string other = Printable(dds_type);
  const size_t at = dds_type.find(kTypeNamespace);
  if (at == absl::string_view::npos) return other;
  absl::string_view package = dds_type.substr(0, at);  // "std_msgs::msg::"
  absl::string_view base = dds_type.substr(at + kTypeNamespace.size());
  if (!absl::ConsumeSuffix(&base, "_")) return other;
  if (!absl::ConsumeSuffix(&package, "::")) return other;
  if (absl::EndsWith(package, "::srv") || absl::EndsWith(package, "::action")) {
    if (!absl::ConsumeSuffix(&base, "_Request")) absl::ConsumeSuffix(&base, "_Response");
  }
  const std::string type = absl::StrCat(absl::StrReplaceAll(package, {{"::", "/"}}), "/", base);
  return ValidateName("type", absl::StrCat("/", type)).ok() ? type : other;
}

EndpointKind KindOf(DdsTopicKind kind, bool writer) {
  switch (kind) {
    case DdsTopicKind::kTopic:
    case DdsTopicKind::kOther:
      return writer ? EndpointKind::kPublisher : EndpointKind::kSubscriber;
    case DdsTopicKind::kServiceRequest:
      return writer ? EndpointKind::kClient : EndpointKind::kService;
    case DdsTopicKind::kServiceReply:
      return writer ? EndpointKind::kService : EndpointKind::kClient;
  }
  return EndpointKind::kPublisher;  // not reached
}

std::string MangleTopic(absl::string_view name) { return absl::StrCat("rt", name); }
std::string MangleServiceRequest(absl::string_view name) {
  return absl::StrCat("rq", name, "Request");
}
std::string MangleServiceReply(absl::string_view name) { return absl::StrCat("rr", name, "Reply"); }
std::string MangleType(absl::string_view type) { return MangleTypeWith(type, "_"); }
std::string MangleServiceRequestType(absl::string_view type) {
  return MangleTypeWith(type, "_Request_");
}
std::string MangleServiceReplyType(absl::string_view type) {
  return MangleTypeWith(type, "_Response_");
}

absl::Status ValidateTopicName(absl::string_view name) { return ValidateName("ROS name", name); }
absl::Status ValidateNodeName(absl::string_view full_name) {
  return ValidateName("node name", full_name);
}

std::string JoinNodeName(absl::string_view node_namespace, absl::string_view node_name) {
  if (node_namespace.empty() || node_namespace == "/") return absl::StrCat("/", node_name);
  return absl::StrCat(node_namespace, "/", node_name);
}

std::string Printable(absl::string_view text) {
  constexpr absl::string_view kCut = "...";
  constexpr size_t kEscapeChars = 4;
  std::string out;
  for (char c : text) {
    // Room is kept for one more escape, so that the cut never splits one.
    if (out.size() + kEscapeChars + kCut.size() > kPrintableBytesMax) {
      absl::StrAppend(&out, kCut);
      break;
    }
    if (absl::ascii_isprint(c) && c != '\\') {
      out.push_back(c);
    } else {
      absl::StrAppend(&out, "\\x", absl::Hex(static_cast<uint8_t>(c), absl::kZeroPad2));
    }
  }
  return out;
}

}  // namespace rips::ros2
