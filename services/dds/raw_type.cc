#include "services/dds/raw_type.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstring>
#include <memory>
#include <type_traits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "dds/dds.h"
#include "dds/ddsi/ddsi_serdata.h"
#include "dds/ddsi/ddsi_sertype.h"
#include "dds/ddsi/q_protocol.h"
#include "dds/ddsi/q_radmin.h"
#include "dds/version.h"
#include "services/base/check.h"
#include "services/base/status_macros.h"
#include "services/dds/domain_internals.h"
#include "services/ros2/cdr.h"
#include "services/ros2/ros_name.h"

#if DDS_VERSION_MAJOR != 0 || DDS_VERSION_MINOR != 10
#error "raw_type.cc knows the internal interface of Cyclone DDS 0.10 only"
#endif

namespace rips::dds {
namespace {

using ros2::kCdrHeaderBytes;

// The only state that outlives a call: a count, for diagnosis.
std::atomic<uint64_t> refused_samples = 0;

struct RawSertype : ddsi_sertype {
  RawSertype() : ddsi_sertype{} {}
  uint32_t payload_bytes_max = kWholePayload;
  // In place of it, unless null.
  std::shared_ptr<const PayloadLimit> limit;
};

struct RawSerdata : ddsi_serdata {
  RawSerdata() : ddsi_serdata{} {}

  uint32_t kept = 0;  // bytes of the payload that are kept
  uint32_t size = 0;  // bytes of the whole payload
  uint64_t writer_sequence = 0;
  ros2::Guid related_writer;
  uint64_t related_sequence = 0;
  // kept bytes, then zeros up to a multiple of 4, which Cyclone may read when it sends.
  std::unique_ptr<char[]> bytes;
};

const RawSerdata* Raw(const ddsi_serdata* data) { return static_cast<const RawSerdata*>(data); }
const RawSertype* Raw(const ddsi_sertype* type) { return static_cast<const RawSertype*>(type); }

constexpr size_t AlignUp4(size_t size) { return (size + 3) & ~size_t{3}; }

// Null if out of memory: no exception may pass through Cyclone.
std::unique_ptr<RawSerdata> NewSerdata(const ddsi_sertype* type, ddsi_serdata_kind kind,
                                       size_t size, size_t kept) noexcept {
  std::unique_ptr<RawSerdata> data(new (std::nothrow) RawSerdata);
  if (data == nullptr) return nullptr;
  ddsi_serdata_init(data.get(), type, kind);
  data->hash = type->serdata_basehash;  // no key: one instance
  data->size = static_cast<uint32_t>(size);
  data->kept = static_cast<uint32_t>(kept);
  const size_t room = AlignUp4(kept);
  data->bytes.reset(new (std::nothrow) char[room]);
  if (data->bytes == nullptr) return nullptr;
  std::memset(data->bytes.get() + kept, 0, room - kept);
  return data;
}

ddsi_serdata* Refuse() noexcept {
  refused_samples.fetch_add(1, std::memory_order_relaxed);
  return nullptr;
}

bool SizeMakesSense(size_t size) { return size >= kCdrHeaderBytes && size < UINT32_MAX - 4; }

size_t KeptOf(const ddsi_sertype* type, size_t size) {
  const RawSertype* raw = Raw(type);
  if (raw->limit == nullptr) return std::min<size_t>(size, raw->payload_bytes_max);
  const uint32_t limit = raw->limit->load(std::memory_order_relaxed);
  return std::min<size_t>(size, std::max<size_t>(limit, kCdrHeaderBytes));
}

// DDSI-RTPS 2.5 §9.4.5.4: the writer's sequence number, which Cyclone has put into host order.
uint64_t SequenceOf(const nn_rdata* first) {
  const size_t offset = NN_RDATA_SUBMSG_OFF(first);
  if (offset == 0) return 0;
  Data_DataFrag_common_t submessage;
  std::memcpy(&submessage, NN_RMSG_PAYLOADOFF(first->rmsg, offset), sizeof(submessage));
  return static_cast<uint64_t>(static_cast<uint32_t>(submessage.writerSN.high)) << 32 |
         submessage.writerSN.low;
}

// The related sample identity, from the inline QoS between the submessage's header and the payload
// (DDSI-RTPS 2.5 §9.4.5.4, §9.4.2.11): under the number the standard gave it, and the one Fast DDS
// used before. Whatever makes no sense there counts as absent.
void ReadRelatedSample(const nn_rdata* first, RawSerdata& data) {
  constexpr uint8_t kLittleEndian = 0x01;
  constexpr uint8_t kInlineQos = 0x02;
  constexpr uint16_t kSentinel = 0x0001;
  constexpr uint16_t kRelatedSample = 0x0083;
  constexpr uint16_t kRelatedSampleBefore = 0x800f;
  constexpr size_t kIdentityBytes = 24;
  const size_t offset = NN_RDATA_SUBMSG_OFF(first);
  const size_t end = NN_RDATA_PAYLOAD_OFF(first);
  if (offset == 0 || end < offset + sizeof(Data_DataFrag_common_t)) return;
  Data_DataFrag_common_t submessage;
  std::memcpy(&submessage, NN_RMSG_PAYLOADOFF(first->rmsg, offset), sizeof(submessage));
  if ((submessage.smhdr.flags & kInlineQos) == 0) return;
  const bool little = (submessage.smhdr.flags & kLittleEndian) != 0;
  const auto* bytes = reinterpret_cast<const uint8_t*>(NN_RMSG_PAYLOADOFF(first->rmsg, 0));
  const auto u16 = [&](size_t at) {
    return static_cast<uint16_t>(little ? bytes[at] | bytes[at + 1] << 8
                                        : bytes[at] << 8 | bytes[at + 1]);
  };
  const auto u32 = [&](size_t at) {
    const uint64_t low = u16(little ? at : at + 2);
    return low | static_cast<uint64_t>(u16(little ? at + 2 : at)) << 16;
  };
  // The field counts from behind itself; Cyclone has put it into host order.
  size_t at = offset + offsetof(Data_DataFrag_common_t, octetsToInlineQos) + sizeof(uint16_t) +
              submessage.octetsToInlineQos;
  while (at + 4 <= end) {
    const uint16_t id = u16(at);
    const size_t length = u16(at + 2);
    at += 4;
    if (id == kSentinel || length > end - at) return;
    if ((id == kRelatedSample || id == kRelatedSampleBefore) && length >= kIdentityBytes) {
      std::copy_n(bytes + at, data.related_writer.bytes.size(), data.related_writer.bytes.begin());
      data.related_sequence = u32(at + 16) << 32 | u32(at + 20);
      return;
    }
    at += length;
  }
}

uint32_t GetSize(const ddsi_serdata* data) noexcept { return Raw(data)->kept; }

bool EqualKey(const ddsi_serdata*, const ddsi_serdata*) noexcept { return true; }

ddsi_serdata* KeyOnly(const ddsi_sertype* type) noexcept {
  return NewSerdata(type, SDK_KEY, 0, 0).release();
}

// Fragments come in order of their start and may overlap.
ddsi_serdata* FromFragments(const ddsi_sertype* type, ddsi_serdata_kind kind,
                            const nn_rdata* fragment, size_t size) noexcept {
  if (kind != SDK_DATA) return KeyOnly(type);
  if (!SizeMakesSense(size) || fragment == nullptr) return Refuse();
  const size_t kept = KeptOf(type, size);
  std::unique_ptr<RawSerdata> data = NewSerdata(type, kind, size, kept);
  if (data == nullptr) return Refuse();
  data->writer_sequence = SequenceOf(fragment);
  ReadRelatedSample(fragment, *data);
  size_t at = 0;
  for (; fragment != nullptr && at < kept; fragment = fragment->nextfrag) {
    if (fragment->min > at || fragment->maxp1 < fragment->min || fragment->maxp1 > size) {
      return Refuse();
    }
    if (fragment->maxp1 <= at) continue;
    const unsigned char* from =
        NN_RMSG_PAYLOADOFF(fragment->rmsg, NN_RDATA_PAYLOAD_OFF(fragment)) + (at - fragment->min);
    const size_t end = std::min<size_t>(fragment->maxp1, kept);
    std::memcpy(data->bytes.get() + at, from, end - at);
    at = end;
  }
  if (at < kept) return Refuse();
  return data.release();
}

// Within the process: from a writer whose type differs from the reader's in the limit.
ddsi_serdata* FromVectors(const ddsi_sertype* type, ddsi_serdata_kind kind,
                          ddsrt_msg_iovlen_t count, const ddsrt_iovec_t* vectors,
                          size_t size) noexcept {
  if (kind != SDK_DATA) return KeyOnly(type);
  if (!SizeMakesSense(size)) return Refuse();
  const size_t kept = KeptOf(type, size);
  std::unique_ptr<RawSerdata> data = NewSerdata(type, kind, size, kept);
  if (data == nullptr) return Refuse();
  size_t at = 0;
  for (size_t i = 0; i < count && at < kept; ++i) {
    const size_t length = std::min<size_t>(vectors[i].iov_len, kept - at);
    std::memcpy(data->bytes.get() + at, vectors[i].iov_base, length);
    at += length;
  }
  if (at < kept) return Refuse();
  return data.release();
}

ddsi_serdata* FromKeyhash(const ddsi_sertype* type, const ddsi_keyhash*) noexcept {
  return KeyOnly(type);
}

// Samples are made by WriteRaw only.
ddsi_serdata* FromSample(const ddsi_sertype*, ddsi_serdata_kind, const void*) noexcept {
  return nullptr;
}

// `size` bytes from `offset`, which may end in the padding; zeros for anything beyond.
void ToSer(const ddsi_serdata* data, size_t offset, size_t size, void* out) noexcept {
  const RawSerdata* raw = Raw(data);
  const size_t room = AlignUp4(raw->kept);
  const size_t begin = std::min(offset, room);
  const size_t held = std::min(size, room - begin);
  std::memcpy(out, raw->bytes.get() + begin, held);
  std::memset(static_cast<char*>(out) + held, 0, size - held);
}

ddsi_serdata* ToSerRef(const ddsi_serdata* data, size_t offset, size_t size,
                       ddsrt_iovec_t* out) noexcept {
  const RawSerdata* raw = Raw(data);
  RIPS_CHECK(offset + size <= AlignUp4(raw->kept), "Cyclone asks for more than get_size() gave");
  out->iov_base = raw->bytes.get() + offset;
  out->iov_len = static_cast<ddsrt_iov_len_t>(size);
  return ddsi_serdata_ref(data);
}

void ToSerUnref(ddsi_serdata* data, const ddsrt_iovec_t*) noexcept { ddsi_serdata_unref(data); }

bool ToSample(const ddsi_serdata*, void*, void**, void*) noexcept { return false; }

ddsi_serdata* ToUntyped(const ddsi_serdata* data) noexcept {
  if (data->type == nullptr) return ddsi_serdata_ref(data);
  ddsi_serdata* untyped = KeyOnly(data->type);
  if (untyped != nullptr) untyped->type = nullptr;
  return untyped;
}

bool UntypedToSample(const ddsi_sertype*, const ddsi_serdata*, void*, void**, void*) noexcept {
  return false;
}

void Free(ddsi_serdata* data) noexcept { delete static_cast<RawSerdata*>(data); }

size_t Print(const ddsi_sertype*, const ddsi_serdata*, char* out, size_t size) noexcept {
  constexpr char kText[] = "raw";
  const size_t length = std::min(size - 1, sizeof(kText) - 1);
  std::memcpy(out, kText, length);
  out[length] = '\0';
  return length;
}

void GetKeyhash(const ddsi_serdata*, ddsi_keyhash* out, bool) noexcept {
  std::memset(out, 0, sizeof(*out));
}

constexpr ddsi_serdata_ops kSerdataOps = {
    .eqkey = EqualKey,
    .get_size = GetSize,
    .from_ser = FromFragments,
    .from_ser_iov = FromVectors,
    .from_keyhash = FromKeyhash,
    .from_sample = FromSample,
    .to_ser = ToSer,
    .to_ser_ref = ToSerRef,
    .to_ser_unref = ToSerUnref,
    .to_sample = ToSample,
    .to_untyped = ToUntyped,
    .untyped_to_sample = UntypedToSample,
    .free = Free,
    .print = Print,
    .get_keyhash = GetKeyhash,
#ifdef DDS_HAS_SHM
    // Never called: ExamineDomain.
    .get_sample_size = nullptr,
    .from_iox_buffer = nullptr,
#endif
};
static_assert(sizeof(ddsi_serdata_ops) == sizeof(void*) *
#ifdef DDS_HAS_SHM
                                              17,
#else
                                              15,
#endif
              "an operation was added that is not filled in above");

void FreeType(ddsi_sertype* type) noexcept {
  ddsi_sertype_fini(type);
  delete static_cast<RawSertype*>(type);
}

void ZeroSamples(const ddsi_sertype*, void*, size_t) noexcept {}
void ReallocSamples(void**, const ddsi_sertype*, void*, size_t, size_t) noexcept {}
void FreeSamples(const ddsi_sertype*, void**, size_t, dds_free_op_t) noexcept {}

bool EqualType(const ddsi_sertype* a, const ddsi_sertype* b) noexcept {
  return Raw(a)->payload_bytes_max == Raw(b)->payload_bytes_max && Raw(a)->limit == Raw(b)->limit;
}

// Of all that EqualType compares: Cyclone's table of types doubles until no more than 32 of one
// hash lie together, so that some hundred readers of one ROS type would take gigabytes.
uint32_t HashType(const ddsi_sertype* type) noexcept {
  const auto limit = reinterpret_cast<uintptr_t>(Raw(type)->limit.get());
  const uint64_t mixed = (uint64_t{limit} ^ Raw(type)->payload_bytes_max) * 0x9e3779b97f4a7c15;
  return static_cast<uint32_t>(mixed >> 32);
}

// No type information is given, and none derived: matching is by name.
constexpr ddsi_sertype_ops kSertypeOps = {
    .version = ddsi_sertype_v0,
    .arg = nullptr,
    .free = FreeType,
    .zero_samples = ZeroSamples,
    .realloc_samples = ReallocSamples,
    .free_samples = FreeSamples,
    .equal = EqualType,
    .hash = HashType,
    .type_id = nullptr,
    .type_map = nullptr,
    .type_info = nullptr,
    .derive_sertype = nullptr,
    .get_serialized_size = nullptr,
    .serialize_into = nullptr,
};
static_assert(sizeof(ddsi_sertype_ops) == 14 * sizeof(void*),
              "an operation was added that is not filled in above");

}  // namespace

absl::StatusOr<RawTopic> CreateRawTopic(EntityHandle participant, const std::string& topic,
                                        const std::string& type, uint32_t payload_bytes_max,
                                        std::shared_ptr<const PayloadLimit> limit) {
  if (payload_bytes_max < kCdrHeaderBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("`payload_bytes_max` of ", payload_bytes_max, " is below ", kCdrHeaderBytes));
  }
  auto* raw = new RawSertype;
  raw->payload_bytes_max = payload_bytes_max;
  raw->limit = std::move(limit);
  ddsi_sertype_init_flags(raw, type.c_str(), &kSertypeOps, &kSerdataOps,
                          DDSI_SERTYPE_FLAG_TOPICKIND_NO_KEY);
  raw->allowed_data_representation =
      DDS_DATA_REPRESENTATION_FLAG_XCDR1 | DDS_DATA_REPRESENTATION_FLAG_XCDR2;
  // On success Cyclone owns it, and `registered` is it or an equal one from before.
  ddsi_sertype* registered = raw;
  DdsEntity entity(
      dds_create_topic_sertype(participant, topic.c_str(), &registered, nullptr, nullptr, nullptr));
  if (entity.get() < 0) {
    ddsi_sertype_unref(raw);
    return DdsError(absl::StrCat("creating topic `", ros2::Printable(topic), "` of type `",
                                 ros2::Printable(type), "`"),
                    entity.get());
  }
  return RawTopic{.entity = std::move(entity), .type = registered};
}

absl::StatusOr<InterfacesInUse> ExamineDomain(EntityHandle participant, const std::string& topic) {
  // Only a registered type leads to the domain's configuration. No endpoint uses the topic, so
  // no other code learns of it.
  RIPS_ASSIGN_OR_RETURN(const RawTopic probe, CreateRawTopic(participant, topic, "none"));
  if (rips_dds_uses_shared_memory(probe.type)) {
    return absl::FailedPreconditionError(
        "`SharedMemory/Enable` is on in the Cyclone configuration; samples sent through shared "
        "memory cannot be observed, turn it off");
  }
  InterfacesInUse in_use;
  std::array<rips_dds_interface, kInterfacesMax> found;
  const size_t count =
      rips_dds_interfaces(probe.type, found.data(), found.size(), &in_use.automatic);
  for (size_t i = 0; i < count; ++i) {
    in_use.addresses.push_back(
        {.interface = found[i].name,
         .index = found[i].index,
         .address = FormatAddress(found[i].address + (found[i].ipv6 ? 0 : 12), found[i].ipv6),
         .ipv6 = found[i].ipv6});
  }
  return in_use;
}

RawContent ContentOf(const ddsi_serdata* sample) {
  const RawSerdata* raw = Raw(sample);
  return {.payload = absl::string_view(raw->bytes.get(), raw->kept),
          .size = raw->size,
          .writer_sequence = raw->writer_sequence,
          .related_writer = raw->related_writer,
          .related_sequence = raw->related_sequence};
}

absl::Status WriteRaw(EntityHandle writer, const ddsi_sertype* type, absl::string_view payload,
                      int64_t source_unix_ns) {
  if (!SizeMakesSense(payload.size())) {
    return absl::InvalidArgumentError(absl::StrCat("a payload of ", payload.size(),
                                                   " bytes has no encapsulation header or is "
                                                   "larger than RTPS carries"));
  }
  std::unique_ptr<RawSerdata> data = NewSerdata(type, SDK_DATA, payload.size(), payload.size());
  if (data == nullptr) return absl::ResourceExhaustedError("no memory for a sample");
  std::memcpy(data->bytes.get(), payload.data(), payload.size());
  data->timestamp.v = source_unix_ns;
  // Both take the reference over, also on failure.
  ddsi_serdata* sample = data.release();
  const dds_return_t code =
      source_unix_ns == 0 ? dds_writecdr(writer, sample) : dds_forwardcdr(writer, sample);
  return code < 0 ? DdsError("writing a sample", code) : absl::OkStatus();
}

uint64_t RefusedSamples() { return refused_samples.load(std::memory_order_relaxed); }

}  // namespace rips::dds
