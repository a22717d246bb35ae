#include "services/dds/discovery.h"

#include <algorithm>
#include <array>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "dds/dds.h"
#include "services/dds/qos.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/mutex.h"

namespace rips::dds {
namespace {

constexpr size_t kTakeMax = 64;
// Type names of the readers behind Discovery itself, which only Discovery uses.
constexpr absl::string_view kBuiltinTypes = "org::eclipse::cyclonedds::builtin::";

ParticipantSeen Describe(const dds_builtintopic_participant_t& sample,
                         const dds_sample_info_t& info, bool secured) {
  ParticipantSeen seen;
  seen.alive = info.valid_data && info.instance_state == DDS_ALIVE_INSTANCE_STATE;
  seen.guid = ToGuid(sample.key);
  seen.instance = info.instance_handle;
  if (!seen.alive) return seen;
  const std::string enclave = UserDataField(ReadUserData(sample.qos), "enclave");
  if (!secured || ProvesEnclave(seen.guid, enclave)) seen.enclave = ros2::Printable(enclave);
  seen.host = ReadProperty(sample.qos, "__Hostname");
  seen.process = ReadProperty(sample.qos, "__ProcessName");
  seen.addresses = ReadProperty(sample.qos, "__NetworkAddresses");
  if (!absl::SimpleAtoi(ReadProperty(sample.qos, "__Pid"), &seen.pid)) seen.pid = 0;
  seen.vendor = absl::BytesToHexString(seen.guid.ToBytes().substr(0, 2));
  return seen;
}

EndpointSeen Describe(const dds_builtintopic_endpoint_t& sample, const dds_sample_info_t& info,
                      bool writer) {
  EndpointSeen seen;
  seen.alive = info.valid_data && info.instance_state == DDS_ALIVE_INSTANCE_STATE;
  seen.writer = writer;
  seen.guid = ToGuid(sample.key);
  seen.participant = seen.guid.Participant();
  seen.instance = info.instance_handle;
  if (!seen.alive) return seen;
  seen.topic = sample.topic_name;
  seen.type = sample.type_name;
  seen.qos = ReadQos(sample.qos);
  if (writer) seen.unreadable = WhyUnreadable(sample.qos);
  seen.user_data = ReadUserData(sample.qos);
  return seen;
}

// Hands every sample of `reader` to `use`, kTakeMax at a time.
template <typename Sample, typename Use>
void DrainSamples(EntityHandle reader, Use use) {
  for (;;) {
    std::array<void*, kTakeMax> samples = {};
    std::array<dds_sample_info_t, kTakeMax> infos;
    const dds_return_t count =
        dds_take(reader, samples.data(), infos.data(), samples.size(), kTakeMax);
    for (dds_return_t i = 0; i < count; ++i) {
      use(*static_cast<const Sample*>(samples[i]), infos[i]);
    }
    if (count > 0) dds_return_loan(reader, samples.data(), count);
    if (count < static_cast<dds_return_t>(kTakeMax)) return;
  }
}

}  // namespace

struct Discovery::Impl {
  Impl(DiscoveryCallbacks to_call, bool with_security)
      : callbacks(std::move(to_call)), secured(with_security) {}

  static void OnParticipants(dds_entity_t reader, void* impl) noexcept {
    static_cast<Impl*>(impl)->DrainParticipants(reader);
  }
  static void OnWriters(dds_entity_t reader, void* impl) noexcept {
    static_cast<Impl*>(impl)->DrainEndpoints(reader, /*of_writers=*/true);
  }
  static void OnReaders(dds_entity_t reader, void* impl) noexcept {
    static_cast<Impl*>(impl)->DrainEndpoints(reader, /*of_writers=*/false);
  }

  void DrainParticipants(EntityHandle reader) ABSL_LOCKS_EXCLUDED(mu) {
    MutexLock lock(&mu);
    DrainSamples<dds_builtintopic_participant_t>(
        reader,
        [this](const dds_builtintopic_participant_t& sample, const dds_sample_info_t& info) {
          if (callbacks.on_participant) callbacks.on_participant(Describe(sample, info, secured));
        });
  }

  void DrainEndpoints(EntityHandle reader, bool of_writers) ABSL_LOCKS_EXCLUDED(mu) {
    MutexLock lock(&mu);
    DrainSamples<dds_builtintopic_endpoint_t>(
        reader, [this, of_writers](const dds_builtintopic_endpoint_t& sample,
                                   const dds_sample_info_t& info) {
          const EndpointSeen seen = Describe(sample, info, of_writers);
          if (absl::StartsWith(seen.type, kBuiltinTypes)) return;
          if (callbacks.on_endpoint) callbacks.on_endpoint(seen);
        });
  }

  absl::Status Listen(const Participant& participant, EntityHandle topic,
                      dds_on_data_available_fn on_data, DdsEntity& reader) {
    dds_listener_t* listener = dds_create_listener(this);
    dds_lset_data_available(listener, on_data);
    reader = DdsEntity(dds_create_reader(participant.entity(), topic, nullptr, listener));
    dds_delete_listener(listener);
    if (reader.get() < 0) return DdsError("creating a reader of a built-in topic", reader.get());
    // What was known before the reader existed may have raised no event.
    on_data(reader.get(), this);
    return absl::OkStatus();
  }

  const DiscoveryCallbacks callbacks;
  const bool secured;
  Mutex mu;  // held during callbacks, so that they never overlap
  // Last, so they go first: then no callback runs any more.
  DdsEntity participants;
  DdsEntity writers;
  DdsEntity readers;
};

Discovery::Discovery(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Discovery::~Discovery() = default;

absl::StatusOr<std::unique_ptr<Discovery>> Discovery::Create(const Participant& participant,
                                                             DiscoveryCallbacks callbacks) {
  auto impl = std::make_unique<Impl>(std::move(callbacks), participant.secured());
  struct Source {
    EntityHandle topic;
    dds_on_data_available_fn on_data;
    DdsEntity& reader;
  };
  const Source sources[] = {
      {DDS_BUILTIN_TOPIC_DCPSPARTICIPANT, &Impl::OnParticipants, impl->participants},
      {DDS_BUILTIN_TOPIC_DCPSPUBLICATION, &Impl::OnWriters, impl->writers},
      {DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION, &Impl::OnReaders, impl->readers}};
  for (const Source& source : sources) {
    const absl::Status status =
        impl->Listen(participant, source.topic, source.on_data, source.reader);
    if (!status.ok()) return status;
  }
  return std::unique_ptr<Discovery>(new Discovery(std::move(impl)));
}

}  // namespace rips::dds
