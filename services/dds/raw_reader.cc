#include "services/dds/raw_reader.h"

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/container/flat_hash_map.h"
#include "absl/strings/str_cat.h"
#include "dds/dds.h"
#include "dds/ddsi/ddsi_serdata.h"
#include "services/base/status_macros.h"
#include "services/dds/qos.h"
#include "services/dds/writer_numbers.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::dds {
namespace {

// Samples taken at a time.
constexpr size_t kTakeMax = 64;
// Writers whose GUID is remembered per reader. Past it the memory starts anew: GUIDs of writers
// that are gone are then no longer known.
constexpr size_t kWritersMax = 4'096;

OwnedQos ReaderQos(const RawReaderOptions& options, bool secured) {
  OwnedQos qos = MakeQos(options.user_data);
  const bool reliable = options.reliable || options.reliable_transient_local;
  dds_qset_reliability(qos.get(), reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
                       kMaxBlocking);
  dds_qset_durability(qos.get(), options.reliable_transient_local ? DDS_DURABILITY_TRANSIENT_LOCAL
                                                                  : DDS_DURABILITY_VOLATILE);
  dds_qset_history(qos.get(), options.keep_all ? DDS_HISTORY_KEEP_ALL : DDS_HISTORY_KEEP_LAST,
                   static_cast<int32_t>(std::clamp<uint32_t>(options.depth, 1, INT32_MAX)));
  // DDS 1.4 §2.2.3.8: a writer that offers a longer budget than the reader asks does not match.
  dds_qset_latency_budget(qos.get(), DDS_INFINITY);
  if (options.every_partition && !secured) {
    std::vector<std::string> partitions = {"", "*"};
    partitions.insert(partitions.end(), options.partitions.begin(), options.partitions.end());
    SetPartitions(qos.get(), partitions);
  }
  if (options.ignore_own) dds_qset_ignorelocal(qos.get(), DDS_IGNORELOCAL_PARTICIPANT);
  const dds_data_representation_id_t representations[] = {DDS_DATA_REPRESENTATION_XCDR1,
                                                          DDS_DATA_REPRESENTATION_XCDR2};
  dds_qset_data_representation(qos.get(), std::size(representations), representations);
  return qos;
}

// none() if that writer is not matched (any more).
ros2::Guid MatchedWriter(EntityHandle reader, InstanceHandle publication) {
  dds_builtintopic_endpoint_t* data = dds_get_matched_publication_data(reader, publication);
  if (data == nullptr) return {};
  const ros2::Guid guid = ToGuid(data->key);
  dds_builtintopic_free_endpoint(data);
  return guid;
}

// Gives every sample of a take back, whatever happens to the others.
class TakenSamples {
 public:
  explicit TakenSamples(EntityHandle reader)
      : count_(dds_takecdr(reader, samples_.data(), kTakeMax, infos_.data(), DDS_ANY_STATE)) {}
  TakenSamples(const TakenSamples&) = delete;
  TakenSamples& operator=(const TakenSamples&) = delete;
  ~TakenSamples() {
    for (size_t i = 0; i < size(); ++i) ddsi_serdata_unref(samples_[i]);
  }

  size_t size() const { return count_ < 0 ? 0 : static_cast<size_t>(count_); }
  const ddsi_serdata* sample(size_t i) const { return samples_[i]; }
  const dds_sample_info_t& info(size_t i) const { return infos_[i]; }

 private:
  std::array<ddsi_serdata*, kTakeMax> samples_;
  std::array<dds_sample_info_t, kTakeMax> infos_;
  dds_return_t count_;
};

}  // namespace

struct RawReader::Impl {
  Impl(RawCallback to_call, std::function<void()> when_matched)
      : callback(std::move(to_call)), on_match(std::move(when_matched)) {}

  static void OnDataAvailable(dds_entity_t reader, void* impl) noexcept {
    static_cast<Impl*>(impl)->Drain(reader);
  }
  static void OnMatch(dds_entity_t, const dds_subscription_matched_status_t, void* impl) noexcept {
    static_cast<Impl*>(impl)->on_match();
  }

  // Takes all there is. The reader comes as an argument because data may be there before
  // dds_create_reader has returned.
  void Drain(EntityHandle reader) noexcept ABSL_LOCKS_EXCLUDED(mu) {
    MutexLock lock(&mu);
    for (;;) {
      const TakenSamples taken(reader);
      for (size_t i = 0; i < taken.size(); ++i) Deliver(reader, taken.sample(i), taken.info(i));
      if (taken.size() < kTakeMax) return;
    }
  }

  void Deliver(EntityHandle reader, const ddsi_serdata* data, const dds_sample_info_t& info)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) {
    if (!info.valid_data) return;  // a writer is gone; its payload is none
    const RawContent content = ContentOf(data);
    callback({.payload = content.payload,
              .size = content.size,
              .writer_sequence = content.writer_sequence,
              .source_unix_ns = info.source_timestamp,
              .received = clock.Now(),
              .publication = info.publication_handle,
              .writer = WriterOf(reader, info.publication_handle),
              .related_writer = content.related_writer,
              .related_sequence = content.related_sequence});
  }

  ros2::Guid WriterOf(EntityHandle reader, InstanceHandle publication)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) {
    const auto known = writers.find(publication);
    if (known != writers.end()) return known->second;
    const ros2::Guid guid = MatchedWriter(reader, publication);
    if (guid.none()) return guid;
    if (writers.size() >= kWritersMax) writers.clear();
    writers.emplace(publication, guid);
    return guid;
  }

  const RawCallback callback;
  const std::function<void()> on_match;
  const RealClock clock;
  // Held during callbacks, so that they never overlap.
  Mutex mu;
  absl::flat_hash_map<InstanceHandle, ros2::Guid> writers ABSL_GUARDED_BY(mu);
  RawTopic topic;
  ros2::Guid own_guid;
  OwnEndpoints::Entry listed;
  DdsEntity entity;  // last, so it goes first: then no callback runs any more
};

RawReader::RawReader(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RawReader::~RawReader() = default;

absl::StatusOr<std::unique_ptr<RawReader>> RawReader::Create(const Participant& participant,
                                                             const RawReaderOptions& options,
                                                             RawCallback callback) {
  auto impl = std::make_unique<Impl>(std::move(callback), options.on_match);
  RIPS_ASSIGN_OR_RETURN(impl->topic,
                        CreateRawTopic(participant.entity(), options.topic, options.type,
                                       options.payload_bytes_max, options.payload_limit));
  const OwnedQos qos = ReaderQos(options, participant.secured());
  dds_listener_t* listener = dds_create_listener(impl.get());
  dds_lset_data_available(listener, &Impl::OnDataAvailable);
  if (impl->on_match) dds_lset_subscription_matched(listener, &Impl::OnMatch);
  impl->entity = DdsEntity(
      dds_create_reader(participant.entity(), impl->topic.entity.get(), qos.get(), listener));
  dds_delete_listener(listener);
  if (impl->entity.get() < 0) {
    return DdsError(absl::StrCat("creating a reader of `", ros2::Printable(options.topic), "`"),
                    impl->entity.get());
  }
  RIPS_ASSIGN_OR_RETURN(impl->own_guid, GuidOf(impl->entity.get()));
  impl->listed = participant.own_endpoints()->Add(options.topic, impl->own_guid, /*writer=*/false);
  return std::unique_ptr<RawReader>(new RawReader(std::move(impl)));
}

const ros2::Guid& RawReader::guid() const { return impl_->own_guid; }
EntityHandle RawReader::entity() const { return impl_->entity.get(); }

std::vector<ros2::Guid> RawReader::MatchedWriters() const {
  std::vector<dds_instance_handle_t> handles(16);
  for (;;) {
    const dds_return_t count =
        dds_get_matched_publications(entity(), handles.data(), handles.size());
    if (count < 0) return {};
    const bool complete = static_cast<size_t>(count) <= handles.size();
    handles.resize(static_cast<size_t>(count));
    if (complete) break;
  }
  std::vector<ros2::Guid> writers;
  for (dds_instance_handle_t handle : handles) {
    const ros2::Guid guid = MatchedWriter(entity(), handle);
    if (!guid.none()) writers.push_back(guid);
  }
  return writers;
}

std::optional<WriterNumbers> RawReader::NumbersOf(const ros2::Guid& writer) const {
  rips_dds_numbers numbers;
  if (!rips_dds_numbers_of(impl_->topic.type, writer.bytes.data(), &numbers)) return std::nullopt;
  return WriterNumbers{.next = numbers.next, .last = numbers.last, .discarded = numbers.discarded};
}

bool RawReader::ForgetNumbersOf(const ros2::Guid& writer) const {
  return rips_dds_forget_numbers(impl_->topic.type, writer.bytes.data());
}

}  // namespace rips::dds
