#include "services/dds/node_announcer.h"

#include <limits>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_set.h"
#include "absl/strings/match.h"
#include "services/base/status_macros.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/ros_name.h"

namespace rips::dds {
namespace {

// The beginning of a claim, which shows its form and its first node.
constexpr uint32_t kHeadBytes = 1'024;
constexpr size_t kEncapsulationBytes = 4;

// The number of nodes, one, and its two names; the same in both forms.
std::string NameBytes(const NodeAnnouncerOptions& options) {
  constexpr size_t kEmptyListsBytes = 8;
  const std::string claim = ros2::EncodeParticipantEntities(
      {.participant = {},
       .nodes = {{.node_namespace = options.node_namespace, .node_name = options.node_name}},
       .gid_bytes = ros2::GidBytes::k16});
  const size_t begin = kEncapsulationBytes + static_cast<size_t>(ros2::GidBytes::k16);
  return claim.substr(begin, claim.size() - begin - kEmptyListsBytes);
}

}  // namespace

NodeAnnouncerOptions AnnouncerOptions(const DdsSettings& settings) {
  NodeAnnouncerOptions options;
  if (settings.gid_bytes != 0) {
    options.gid_bytes = settings.gid_bytes == 16 ? ros2::GidBytes::k16 : ros2::GidBytes::k24;
  }
  return options;
}

NodeAnnouncer::NodeAnnouncer(const Participant& participant, NodeAnnouncerOptions options)
    : options_(std::move(options)),
      participant_(participant.guid()),
      name_bytes_(NameBytes(options_)),
      endpoints_(participant.own_endpoints()),
      votes_(options_.gid_bytes.value_or(options_.initial)) {}

absl::StatusOr<std::unique_ptr<NodeAnnouncer>> NodeAnnouncer::Create(const Participant& participant,
                                                                     NodeAnnouncerOptions options,
                                                                     int64_t now_ns) {
  std::unique_ptr<NodeAnnouncer> announcer(new NodeAnnouncer(participant, std::move(options)));
  RIPS_ASSIGN_OR_RETURN(
      announcer->writer_,
      RawWriter::Create(participant,
                        {.topic = ros2::kDiscoveryTopic,
                         .type = ros2::kDiscoveryType,
                         .qos = {.reliable = true, .transient_local = true, .depth = 1}}));
  if (announcer->options_.listen && !announcer->options_.gid_bytes.has_value()) {
    auto reader = RawReader::Create(participant,
                                    {.topic = ros2::kDiscoveryTopic,
                                     .type = ros2::kDiscoveryType,
                                     .reliable_transient_local = true,
                                     .keep_all = true,
                                     .payload_bytes_max = kHeadBytes},
                                    [raw = announcer.get()](const RawSample& sample) {
                                      raw->Heard(sample.writer.Participant(), sample.payload);
                                    });
    announcer->reading_status_ = reader.status();
    if (reader.ok()) announcer->reader_ = *std::move(reader);
  }
  RIPS_RETURN_IF_ERROR(announcer->Publish(now_ns));
  return announcer;
}

void NodeAnnouncer::Heard(const ros2::Guid& participant, absl::string_view claim) {
  if (options_.gid_bytes.has_value() || participant == participant_) return;
  const std::optional<ros2::GidBytes> form = ros2::GidFormOf(claim);
  if (!form.has_value()) return;
  const size_t names = kEncapsulationBytes + static_cast<size_t>(*form);
  if (absl::StartsWith(claim.substr(names), name_bytes_)) return;
  MutexLock lock(&mu_);
  dissent_ |= *form != votes_.form();
  votes_.Heard(participant, *form);
}

void NodeAnnouncer::Gone(const ros2::Guid& participant) {
  MutexLock lock(&mu_);
  votes_.Gone(participant);
}

ros2::GidBytes NodeAnnouncer::form() const {
  MutexLock lock(&mu_);
  return votes_.form();
}

bool NodeAnnouncer::Changed() const {
  MutexLock lock(&mu_);
  return endpoints_->revision() != revision_ || votes_.form() != published_form_ || dissent_;
}

int64_t NodeAnnouncer::NextDue() const {
  return Changed() ? next_ns_ : std::numeric_limits<int64_t>::max();
}

void NodeAnnouncer::ForgetThoseWhoLeft() {
  // Not with our lock held: it asks the middleware, which may be calling Heard.
  absl::flat_hash_set<ros2::Guid> there;
  for (const ros2::Guid& writer : reader_->MatchedWriters()) there.insert(writer.Participant());
  MutexLock lock(&mu_);
  votes_.Keep([&](const ros2::Guid& participant) { return there.contains(participant); });
}

absl::Status NodeAnnouncer::Poll(int64_t now_ns) {
  if (!Changed() || now_ns < next_ns_) return absl::OkStatus();
  bool dissent = false;
  {
    MutexLock lock(&mu_);
    dissent = std::exchange(dissent_, false);
  }
  if (dissent && reader_ != nullptr) ForgetThoseWhoLeft();
  return Changed() ? Publish(now_ns) : absl::OkStatus();
}

absl::Status NodeAnnouncer::Publish(int64_t now_ns) {
  OwnEndpoints::List list = endpoints_->Now();
  const ros2::GidBytes form = this->form();
  const auto endpoints = static_cast<int64_t>(list.readers.size() + list.writers.size());
  const bool new_form = published_ > 0 && form != published_form_;
  next_ns_ =
      now_ns + (new_form ? kFormIntervalNs : kClaimIntervalNs) + endpoints * kEndpointIntervalNs;
  RIPS_RETURN_IF_ERROR(writer_->Write(
      ros2::EncodeParticipantEntities({.participant = participant_,
                                       .nodes = {{.node_namespace = options_.node_namespace,
                                                  .node_name = options_.node_name,
                                                  .readers = std::move(list.readers),
                                                  .writers = std::move(list.writers)}},
                                       .gid_bytes = form})));
  revision_ = list.revision;
  published_form_ = form;
  ++published_;
  return absl::OkStatus();
}

}  // namespace rips::dds
