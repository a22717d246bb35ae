#include "policy_server/server/store/trace_codec.h"

#include "absl/strings/escaping.h"
#include "services/text/utf8.h"

namespace rips::store {
namespace {

// A string field that is not UTF-8 could not be read again.
std::string ToUtf8(const std::string& text) {
  return FindInvalidUtf8(text).has_value() ? absl::Utf8SafeCHexEscape(text) : text;
}

}  // namespace

rips::v1::Subject EncodeSubject(const engine::TracedSubject& subject) {
  rips::v1::Subject out;
  out.set_name(ToUtf8(subject.name));
  out.set_role(ToUtf8(subject.role));
  if (!subject.guid.none()) out.set_guid(ToString(subject.guid));
  out.set_host(ToUtf8(subject.host));
  out.set_pid(subject.pid);
  out.set_address(ToUtf8(subject.address));
  return out;
}

rips::v1::Evidence EncodeTrace(const engine::Trace& trace) {
  rips::v1::Evidence out;
  out.set_place(ToUtf8(trace.place));
  out.set_condition(ToUtf8(trace.condition));
  for (const engine::TracedValue& value : trace.values) {
    rips::v1::EvidenceValue& added = *out.add_values();
    added.set_offset(value.offset);
    added.set_length(value.length);
    added.set_depth(value.depth);
    added.set_value(ToUtf8(value.value));
  }
  for (const engine::TracedSubject& subject : trace.subjects) {
    *out.add_subjects() = EncodeSubject(subject);
  }
  out.set_event(ToUtf8(trace.event));
  out.set_event_unix_ns(trace.event_unix_ns);
  out.set_bundle(trace.bundle);
  out.set_cut(trace.cut);
  if (trace.has_finding()) *out.mutable_finding() = EncodeFinding(trace.finding);
  return out;
}

rips::v1::Finding EncodeFinding(const model::Finding& finding) {
  rips::v1::Finding out;
  out.set_kind(ToUtf8(finding.kind));
  if (!finding.guid.none()) out.set_guid(finding.guid.ToBytes());
  out.set_node(ToUtf8(finding.node));
  out.set_topic(ToUtf8(finding.topic));
  out.set_detail(ToUtf8(finding.detail));
  out.set_over(finding.over);
  return out;
}

std::string TraceToBytes(const engine::Trace& trace) {
  return trace == engine::Trace{} ? std::string() : EncodeTrace(trace).SerializeAsString();
}

engine::Trace TraceFromBytes(absl::string_view bytes) {
  rips::v1::Evidence evidence;
  if (bytes.empty() || !evidence.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) {
    return {};
  }
  engine::Trace out{.place = evidence.place(),
                    .condition = evidence.condition(),
                    .event = evidence.event(),
                    .event_unix_ns = evidence.event_unix_ns(),
                    .bundle = evidence.bundle(),
                    .cut = evidence.cut()};
  for (const rips::v1::EvidenceValue& value : evidence.values()) {
    out.values.push_back({.offset = value.offset(),
                          .length = value.length(),
                          .depth = value.depth(),
                          .value = value.value()});
  }
  for (const rips::v1::Subject& subject : evidence.subjects()) {
    out.subjects.push_back({.name = subject.name(),
                            .role = subject.role(),
                            .guid = ros2::ParseGuid(subject.guid()).value_or(ros2::Guid{}),
                            .host = subject.host(),
                            .pid = subject.pid(),
                            .address = subject.address()});
  }
  const rips::v1::Finding& finding = evidence.finding();
  out.finding = {.kind = finding.kind(),
                 .guid = ros2::GuidFromBytes(finding.guid()).value_or(ros2::Guid{}),
                 .node = finding.node(),
                 .topic = finding.topic(),
                 .over = finding.over()};
  return out;
}

}  // namespace rips::store
