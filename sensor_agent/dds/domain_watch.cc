#include "sensor_agent/dds/domain_watch.h"

#include <utility>

#include "sensor_agent/wire/locator.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::sensor {

namespace {

// The claim of a participant with some 10,000 endpoints.
constexpr uint32_t kClaimBytesMax = 256 * 1024;

Discovered FromDds(const dds::ParticipantSeen& seen) {
  return {.alive = seen.alive,
          .what = ros2::Participant{.guid = seen.guid,
                                    .host = seen.host,
                                    .enclave = seen.enclave,
                                    .pid = seen.pid,
                                    .vendor = seen.vendor,
                                    .address = wire::FirstAddress(seen.addresses)},
          .addresses = seen.addresses};
}

Discovered FromDds(const dds::EndpointSeen& seen) {
  return {.alive = seen.alive,
          .what = EndpointFact{.guid = seen.guid,
                               .writer = seen.writer,
                               .topic = seen.topic,
                               .type = seen.type,
                               .qos = seen.qos,
                               .unreadable = seen.unreadable},
          .addresses = {}};
}

}  // namespace

DomainWatch::DomainWatch(DomainWatchOptions options, std::function<void()> wake)
    : options_(std::move(options)),
      wake_(std::move(wake)),
      discovered_({.capacity = options_.discovered}),
      claims_({.capacity = options_.claims}) {}

absl::StatusOr<std::unique_ptr<DomainWatch>> DomainWatch::Create(DomainWatchOptions options,
                                                                 std::function<void()> wake) {
  std::unique_ptr<DomainWatch> watch(new DomainWatch(std::move(options), std::move(wake)));
  DomainWatch* raw = watch.get();
  RIPS_ASSIGN_OR_RETURN(watch->participant_, dds::Participant::Create(watch->options_.domain,
                                                                      watch->options_.participant));
  watch->topics_ = std::make_unique<TopicWatcher>(watch->participant_.get(), watch->options_.topics,
                                                  watch->wake_);
  // Before discovery, so that claims are on their way when endpoints become known. All are kept
  // until taken: the topic has no key, so a short history would keep one participant's claim only.
  RIPS_ASSIGN_OR_RETURN(
      watch->claim_reader_,
      dds::RawReader::Create(*watch->participant_,
                             {.topic = ros2::kDiscoveryTopic,
                              .type = ros2::kDiscoveryType,
                              .reliable_transient_local = true,
                              .keep_all = true,
                              .payload_bytes_max = kClaimBytesMax},
                             [raw](const dds::RawSample& sample) { raw->OnClaim(sample); }));
  RIPS_RETURN_IF_ERROR(watch->Rediscover());
  return watch;
}

absl::Status DomainWatch::Rediscover() {
  discovery_.reset();
  RIPS_ASSIGN_OR_RETURN(
      discovery_,
      dds::Discovery::Create(
          *participant_,
          {.on_participant =
               [this](const dds::ParticipantSeen& seen) { OnDiscovered(FromDds(seen)); },
           .on_endpoint = [this](const dds::EndpointSeen& seen) { OnDiscovered(FromDds(seen)); }}));
  return absl::OkStatus();
}

void DomainWatch::OnDiscovered(Discovered discovered) {
  if (!discovered_.Push(std::move(discovered))) ++lost_discovered_;
  wake_();
}

void DomainWatch::OnClaim(const dds::RawSample& sample) {
  const size_t bytes = sample.payload.size();
  const bool room = claim_bytes_.fetch_add(bytes) + bytes <= options_.claim_bytes;
  if (!room || !claims_.Push({.writer = sample.writer, .payload = std::string(sample.payload)})) {
    claim_bytes_ -= bytes;
    ++lost_claims_;
  }
  wake_();
}

std::optional<HeldNumbers> DomainWatch::NumbersOf(const ros2::Guid& writer) const {
  const std::optional<dds::WriterNumbers> held = claim_reader_->NumbersOf(writer);
  if (!held.has_value()) return std::nullopt;
  return HeldNumbers{.next = held->next, .last = held->last, .discarded = held->discarded};
}

std::vector<Discovered> DomainWatch::TakeDiscovered() {
  return discovered_.PopAll(absl::ZeroDuration());
}

std::vector<Claim> DomainWatch::TakeClaims() {
  std::vector<Claim> claims = claims_.PopAll(absl::ZeroDuration());
  for (const Claim& claim : claims) claim_bytes_ -= claim.payload.size();
  return claims;
}

}  // namespace rips::sensor
