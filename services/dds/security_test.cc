#include "services/dds/security.h"

#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <fstream>
#include <map>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/dds/discovery.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/dds/service_client.h"
#include "services/ros2/cdr.h"
#include "services/runtime/mutex.h"
#include "tests/support/ros2/service_server.h"
#include "tests/support/ros2/test_keystore.h"
#include "tests/support/ros2/test_world.h"

namespace rips::dds {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr char kEnclave[] = "/rips/sensor";

// --- The files

class KeystoreTest : public testing::Test {
 protected:
  KeystoreTest() { keystore_.Mint(kEnclave, "sensor"); }

  absl::Status Load(absl::Time now = absl::Now()) const {
    return LoadEnclave(keystore_.dir(), kEnclave, now).status();
  }
  std::string File(absl::string_view name) const { return keystore_.File(kEnclave, name); }
  // In place of the file, which may be a link.
  void Write(absl::string_view name, absl::string_view text) {
    std::filesystem::remove(File(name));
    std::ofstream(File(name)) << text;
  }
  void Take(absl::string_view name, const TestKeystore& other, absl::string_view enclave) {
    std::filesystem::remove(File(name));
    std::filesystem::copy_file(other.File(enclave, name), File(name));
  }

  TestKeystore keystore_;
};

TEST_F(KeystoreTest, GoodEnclaveHasAllItsFiles) {
  const auto enclave = LoadEnclave(keystore_.dir(), kEnclave, absl::Now());
  ASSERT_THAT(enclave, IsOk());
  EXPECT_EQ(enclave->name, kEnclave);
  EXPECT_EQ(enclave->certificate, File("cert.pem"));
  EXPECT_EQ(enclave->crl, "");
  EXPECT_FALSE(enclave->admits_unauthenticated);
}

TEST_F(KeystoreTest, SettingsWithoutSecurityAreNoEnclave) {
  const auto none = LoadSecurity({}, absl::Now());
  ASSERT_THAT(none, IsOk());
  EXPECT_EQ(*none, std::nullopt);
  const auto some = LoadSecurity({.keystore = keystore_.dir(), .enclave = kEnclave}, absl::Now());
  ASSERT_THAT(some, IsOk());
  EXPECT_EQ((*some)->name, kEnclave);
}

TEST_F(KeystoreTest, MissingFileIsNamed) {
  for (const char* name : {"identity_ca.cert.pem", "cert.pem", "key.pem", "permissions_ca.cert.pem",
                           "governance.p7s", "permissions.p7s"}) {
    std::filesystem::rename(File(name), File("aside"));
    EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kNotFound, HasSubstr(File(name))));
    std::filesystem::rename(File("aside"), File(name));
  }
  EXPECT_THAT(Load(), IsOk());
}

TEST_F(KeystoreTest, FileThatIsSomethingElseIsNamed) {
  for (const char* name : {"identity_ca.cert.pem", "cert.pem", "key.pem", "permissions_ca.cert.pem",
                           "governance.p7s", "permissions.p7s", "crl.pem"}) {
    const bool is_there = std::filesystem::exists(File(name));
    if (is_there) std::filesystem::rename(File(name), File("aside"));
    for (const std::string& text : {std::string(), std::string("-----BEGIN CERTIFICATE-----\n"),
                                    std::string(100, '\0'), std::string("MIME-Version: 1.0\n\n")}) {
      Write(name, text);
      EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                                   AllOf(HasSubstr(File(name)), HasSubstr(" is no "))));
    }
    std::filesystem::remove(File(name));
    if (is_there) std::filesystem::rename(File("aside"), File(name));
  }
  EXPECT_THAT(Load(), IsOk());
}

TEST_F(KeystoreTest, HugeFileIsRefused) {
  Write("cert.pem", std::string(kSecurityFileBytesMax + 1, 'x'));
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("cert.pem")));
}

TEST_F(KeystoreTest, KeyOfAnotherCertificate) {
  keystore_.Mint("/other", "node");
  Take("key.pem", keystore_, "/other");
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                               HasSubstr("key.pem` is not the key of `")));
}

TEST_F(KeystoreTest, KeyWithAPassphraseIsRefusedAndNobodyIsAsked) {
  TestKeystore::Run(absl::StrCat("openssl pkey -aes128 -passout pass:secret -in ", File("key.pem"),
                                 " -out ", File("locked.pem")));
  std::filesystem::rename(File("locked.pem"), File("key.pem"));
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                               HasSubstr("is no private key in PEM without passphrase")));
}

TEST_F(KeystoreTest, CertificateOfAnotherAuthority) {
  TestKeystore other;
  other.Mint(kEnclave, "sensor");
  Take("identity_ca.cert.pem", other, kEnclave);
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                               HasSubstr("cert.pem` is not vouched for by `")));
}

TEST_F(KeystoreTest, PermissionsOrGovernanceOfAnotherAuthority) {
  TestKeystore other;
  other.Mint(kEnclave, "sensor");
  Take("permissions.p7s", other, kEnclave);
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                               HasSubstr("permissions.p7s` is not signed by `")));
  keystore_.Mint(kEnclave, "sensor", "--renew");
  EXPECT_THAT(Load(), IsOk());
  Take("governance.p7s", other, kEnclave);
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                               HasSubstr("governance.p7s` is not signed by `")));
}

TEST_F(KeystoreTest, SignedTextThatWasChangedIsRefused) {
  std::ifstream in(File("permissions.p7s"));
  std::string text((std::istreambuf_iterator<char>(in)), {});
  const size_t at = text.find("DENY");
  ASSERT_NE(at, std::string::npos);
  Write("permissions.p7s", text.replace(at, 4, "DANY"));
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is not signed by")));
}

TEST_F(KeystoreTest, PermissionsOfAnotherName) {
  keystore_.Mint("/other", "node");
  Take("permissions.p7s", keystore_, "/other");
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                               HasSubstr("grants `CN=/rips/sensor` nothing, but `CN=/other`")));
}

TEST_F(KeystoreTest, PermissionsThatAllowNothing) {
  const std::string path = keystore_.dir() + "/permissions.xml";
  TestKeystore::Run(absl::StrCat("sed '/<subscribe>/d;/<publish>/d' ", RIPS_SOURCE_DIR,
                                 "/deploy/security/permissions.sensor.xml >", path));
  keystore_.Mint(kEnclave, path, "--renew");
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kInvalidArgument,
                               HasSubstr("allows `CN=/rips/sensor` no topic")));
}

TEST_F(KeystoreTest, ExpiredOrNotYetValid) {
  EXPECT_THAT(Load(absl::Now() + absl::Hours(24 * 364)), IsOk());
  EXPECT_THAT(Load(absl::Now() + absl::Hours(24 * 366)),
              StatusIs(absl::StatusCode::kFailedPrecondition,
                       AllOf(HasSubstr(File("cert.pem")), HasSubstr("has expired"))));
  EXPECT_THAT(Load(absl::Now() - absl::Hours(24)),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("is not valid yet")));
  EXPECT_THAT(
      Load(absl::Now() + absl::Hours(24 * 3'651)),
      StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr(File("identity_ca.cert.pem"))));
}

TEST_F(KeystoreTest, PermissionsThatDoNotHoldNow) {
  const std::string path = keystore_.dir() + "/permissions.xml";
  TestKeystore::Run(absl::StrCat("sed 's/@NOT_AFTER@/2020-01-01T00:00:00+01:00/; ",
                                 "s/@NOT_BEFORE@/2019-01-01T00:00:00Z/' ", RIPS_SOURCE_DIR,
                                 "/deploy/security/permissions.sensor.xml >", path));
  keystore_.Mint(kEnclave, path, "--renew");
  EXPECT_THAT(Load(), StatusIs(absl::StatusCode::kFailedPrecondition,
                               AllOf(HasSubstr("permissions.p7s"), HasSubstr("holds from 2019"))));
}

TEST_F(KeystoreTest, RevokedCertificate) {
  const std::string work = keystore_.dir() + "/crl";
  TestKeystore::Run(
      absl::StrCat("set -e; mkdir ", work, "; cd ", work, "; : >index; echo 01 >serial; ",
                   "printf '[ca]\\ndefault_ca=d\\n[d]\\ndatabase=index\\ncrlnumber=serial\\n",
                   "default_md=sha256\\ndefault_crl_days=9\\n' >conf; ",
                   "CA='-config conf -cert ../public/ca.cert.pem -keyfile ../private/ca.key.pem'; ",
                   "openssl ca $CA -gencrl -out empty.pem 2>log; openssl ca $CA -revoke ",
                   File("cert.pem"), " 2>>log; openssl ca $CA -gencrl -out revoked.pem 2>>log"));
  std::filesystem::copy_file(work + "/empty.pem", File("crl.pem"));
  const auto enclave = LoadEnclave(keystore_.dir(), kEnclave, absl::Now());
  ASSERT_THAT(enclave, IsOk());
  EXPECT_EQ(enclave->crl, File("crl.pem"));
  std::filesystem::remove(File("crl.pem"));
  std::filesystem::copy_file(work + "/revoked.pem", File("crl.pem"));
  EXPECT_THAT(Load(),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("certificate revoked")));
}

TEST_F(KeystoreTest, EnclaveThatIsNoNameOfOne) {
  for (const char* name : {"", "/", "rips", "/rips/", "//rips", "/../x", "/a b", "/a\n"}) {
    EXPECT_THAT(LoadEnclave(keystore_.dir(), name, absl::Now()),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is no enclave")))
        << name;
  }
  EXPECT_THAT(LoadEnclave("k", kEnclave, absl::Now()),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("no absolute path")));
}

TEST_F(KeystoreTest, GovernanceThatAdmitsStrangersIsKnown) {
  const std::string path = keystore_.dir() + "/governance.xml";
  TestKeystore::Run(absl::StrCat("sed '/<allow_un/s/false/ true /' ", RIPS_SOURCE_DIR,
                                 "/deploy/security/governance.xml >", path));
  TestKeystore lax(absl::StrCat("--governance ", path));
  lax.Mint(kEnclave, "sensor");
  EXPECT_TRUE(lax.Load(kEnclave).admits_unauthenticated);
}

TEST_F(KeystoreTest, EnclaveThatWasCopiedIsMintedAnew) {
  const std::string copy = keystore_.dir() + "/copy";
  const std::string folder = keystore_.dir() + "/enclaves/rips/sensor";
  TestKeystore::Run(absl::StrCat("cp -rL ", folder, " ", copy, " && rm -r ", folder, " && mv ",
                                 copy, " ", folder));
  ASSERT_FALSE(std::filesystem::is_symlink(File("governance.p7s")));
  keystore_.Mint(kEnclave, "sensor", "--renew");
  EXPECT_THAT(Load(), IsOk());
  EXPECT_TRUE(std::filesystem::is_symlink(File("governance.p7s")));
}

// --- On the wire

std::string Message() {
  ros2::CdrWriter writer;
  writer.String("hello");
  return std::move(writer).Finish();
}

// Sides of one wire, each with or without DDS Security.
class SecuredDomainTest : public testing::Test {
 protected:
  std::unique_ptr<Participant> Side(std::optional<Enclave> enclave) {
    const ScopedCycloneUri uri(absl::StrCat(
        "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" "
        "multicast=\"true\"/></Interfaces></General><Discovery><ExternalDomainId>",
        RandomDomain(), "</ExternalDomainId><Tag>", Tag(),
        "</Tag><ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>"));
    auto side = Participant::Create({.id = ++sides_}, {.security = std::move(enclave)});
    EXPECT_THAT(side, IsOk());
    return *std::move(side);
  }
  std::unique_ptr<Participant> Secured(TestKeystore& keystore, const std::string& enclave,
                                       const std::string& kind) {
    keystore.Mint(enclave, kind);
    return Side(keystore.Load(enclave));
  }

  uint32_t sides_ = 0;
  TestKeystore keystore_;
};

struct Sight {
  DiscoveryCallbacks Callbacks() {
    return {.on_participant =
                [this](const ParticipantSeen& seen) {
                  MutexLock lock(&mu);
                  if (seen.alive) participants[seen.guid] = seen;
                },
            .on_endpoint =
                [this](const EndpointSeen& seen) {
                  MutexLock lock(&mu);
                  if (seen.alive) endpoints[seen.guid] = seen;
                }};
  }
  bool Knows(const ros2::Guid& guid) {
    MutexLock lock(&mu);
    return participants.contains(guid) || endpoints.contains(guid);
  }
  bool KnowsEndpointsOf(const ros2::Guid& guid) {
    MutexLock lock(&mu);
    return std::any_of(endpoints.begin(), endpoints.end(),
                       [&](const auto& each) { return each.first.SamePrefix(guid); });
  }

  Mutex mu;
  std::map<ros2::Guid, ParticipantSeen> participants;
  std::map<ros2::Guid, EndpointSeen> endpoints;
};

TEST_F(SecuredDomainTest, SensorSeesEndpointsAndMessagesAndStrangersByNameOnly) {
  const auto sensor = Secured(keystore_, "/rips/sensor", "sensor");
  const auto robot = Secured(keystore_, "/talker", "node");
  TestKeystore wrong;
  const auto impostor = Secured(wrong, "/talker", "node");
  const auto stranger = Side(std::nullopt);
  ASSERT_TRUE(sensor->secured());
  ASSERT_FALSE(stranger->secured());
  EXPECT_NE(sensor->guid().bytes[0] & 0x80, 0) << "from the certificate";

  std::map<ros2::Guid, int> samples;
  Mutex mu;
  const auto reader =
      RawReader::Create(*sensor, {.topic = "rt/chatter", .type = "std_msgs::msg::dds_::String_"},
                        [&](const RawSample& sample) {
                          MutexLock lock(&mu);
                          ++samples[sample.writer];
                        });
  ASSERT_THAT(reader, IsOk());
  Sight sight;
  const auto discovery = Discovery::Create(*sensor, sight.Callbacks());
  ASSERT_THAT(discovery, IsOk());
  std::vector<std::unique_ptr<RawWriter>> writers;
  for (const Participant* each : {robot.get(), impostor.get(), stranger.get()}) {
    auto writer =
        RawWriter::Create(*each, {.topic = "rt/chatter", .type = "std_msgs::msg::dds_::String_"});
    ASSERT_THAT(writer, IsOk());
    writers.push_back(*std::move(writer));
  }

  EXPECT_TRUE(Eventually([&] {
    for (const auto& writer : writers) EXPECT_THAT(writer->Write(Message()), IsOk());
    MutexLock lock(&mu);
    return samples[writers[0]->guid()] >= 20;
  })) << "with its GUID, although packets are signed";
  EXPECT_TRUE(sight.KnowsEndpointsOf(robot->guid()));
  EXPECT_TRUE(
      Eventually([&] { return sight.Knows(impostor->guid()) && sight.Knows(stranger->guid()); }));
  EXPECT_FALSE(sight.KnowsEndpointsOf(impostor->guid()));
  EXPECT_FALSE(sight.KnowsEndpointsOf(stranger->guid()));
  MutexLock lock(&mu);
  EXPECT_EQ(samples[writers[1]->guid()], 0);
  EXPECT_EQ(samples[writers[2]->guid()], 0);
}

TEST(EnclaveProofTest, IsInTheFirstBitsOfTheGuid) {
  const auto guid = ros2::ParseGuid("93eb4bd1.65cd75d8.cf19a7be.000001c1");
  ASSERT_THAT(guid, IsOk());
  EXPECT_TRUE(ProvesEnclave(*guid, "/talker"));
  EXPECT_FALSE(ProvesEnclave(*guid, "/talkes"));
  EXPECT_FALSE(ProvesEnclave(*guid, ""));
  EXPECT_FALSE(ProvesEnclave(*guid, std::string(200, 'x')));
  for (size_t byte = 0; byte < 6; ++byte) {
    ros2::Guid other = *guid;
    other.bytes[byte] ^= 1;
    EXPECT_FALSE(ProvesEnclave(other, "/talker")) << byte;
  }
}

TEST_F(SecuredDomainTest, EnclaveThatTheCertificateDoesNotNameIsNotBelieved) {
  const auto sensor = Secured(keystore_, "/rips/sensor", "sensor");
  const auto talker = Secured(keystore_, "/talker", "node");
  keystore_.Mint("/liar", "node");
  Enclave lie = keystore_.Load("/liar");
  lie.name = "/talker";
  const auto liar = Side(lie);
  Sight sight;
  const auto discovery = Discovery::Create(*sensor, sight.Callbacks());
  ASSERT_THAT(discovery, IsOk());
  ASSERT_TRUE(Eventually([&] { return sight.Knows(talker->guid()) && sight.Knows(liar->guid()); }));
  MutexLock lock(&sight.mu);
  EXPECT_EQ(sight.participants[sensor->guid()].enclave, "/rips/sensor");
  EXPECT_EQ(sight.participants[talker->guid()].enclave, "/talker");
  EXPECT_EQ(sight.participants[liar->guid()].enclave, "");
}

TEST_F(SecuredDomainTest, KeyOfASensorCommandsNothing) {
  const auto sensor = Secured(keystore_, "/rips/sensor", "sensor");
  for (const char* topic : {"rt/cmd_vel", "rq/safety/change_modeRequest"}) {
    const auto writer = RawWriter::Create(*sensor, {.topic = topic, .type = "t"});
    EXPECT_THAT(writer, StatusIs(absl::StatusCode::kPermissionDenied)) << topic;
  }
}

TEST_F(SecuredDomainTest, KeyOfAnActuatorCallsServicesOnly) {
  const auto actuator = Secured(keystore_, "/rips/actuator", "actuator");
  EXPECT_THAT(RawWriter::Create(*actuator, {.topic = "rq/safety/change_modeRequest", .type = "t"}),
              IsOk());
  EXPECT_THAT(RawWriter::Create(*actuator, {.topic = "rt/cmd_vel", .type = "t"}),
              StatusIs(absl::StatusCode::kPermissionDenied));
  const auto nothing = [](const RawSample&) {};
  EXPECT_THAT(
      RawReader::Create(*actuator, {.topic = "rr/safety/change_modeReply", .type = "t"}, nothing),
      IsOk());
  EXPECT_THAT(RawReader::Create(*actuator, {.topic = "rt/camera", .type = "t"}, nothing),
              StatusIs(absl::StatusCode::kPermissionDenied));
}

TEST_F(SecuredDomainTest, KeyOfANodeSteersNothingAndAnswersForItsOwnNodesOnly) {
  keystore_.Mint("/drivers", "node /camera /ns/lidar");
  const auto drivers = Side(keystore_.Load("/drivers"));
  const auto writes = [&](const std::string& topic) {
    return RawWriter::Create(*drivers, {.topic = topic, .type = "t"}).status();
  };
  const auto reads = [&](const std::string& topic) {
    return RawReader::Create(*drivers, {.topic = topic, .type = "t"}, [](const RawSample&) {})
        .status();
  };
  for (const char* service :
       {"change_mode", "change_state", "set_parameters", "set_parameters_atomically"}) {
    for (const char* part : {"/safety", "/base", "/camera", "/a/b"}) {
      EXPECT_THAT(writes(absl::StrCat("rq", part, "/", service, "Request")),
                  StatusIs(absl::StatusCode::kPermissionDenied))
          << part << service;
    }
    EXPECT_THAT(reads(absl::StrCat("rq/safety/", service, "Request")),
                StatusIs(absl::StatusCode::kPermissionDenied));
    EXPECT_THAT(reads(absl::StrCat("rq/camera/", service, "Request")), IsOk());
    EXPECT_THAT(writes(absl::StrCat("rr/base/", service, "Reply")),
                StatusIs(absl::StatusCode::kPermissionDenied));
    EXPECT_THAT(writes(absl::StrCat("rr/ns/lidar/", service, "Reply")), IsOk());
  }
  for (const char* service : {"get_mode", "get_available_modes", "get_state", "get_parameters"}) {
    EXPECT_THAT(writes(absl::StrCat("rr/base/", service, "Reply")),
                StatusIs(absl::StatusCode::kPermissionDenied));
    EXPECT_THAT(writes(absl::StrCat("rr/camera/", service, "Reply")), IsOk());
    EXPECT_THAT(writes(absl::StrCat("rq/base/", service, "Request")), IsOk());
  }
  EXPECT_THAT(writes("rt/base/transition_event"), StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(writes("rt/camera/transition_event"), IsOk());
  for (const char* topic : {"ros_discovery_info", "rt/image", "rq/planner/planRequest"}) {
    EXPECT_THAT(writes(topic), IsOk()) << topic;
    EXPECT_THAT(reads(topic), IsOk()) << topic;
  }
}

TEST_F(SecuredDomainTest, ActuatorCallsAServiceOfASecuredNode) {
  const auto actuator = Secured(keystore_, "/rips/actuator", "actuator");
  const auto manager = Secured(keystore_, "/mode_manager", "manager");
  const ServiceOptions service = {.service = "/safety/change_mode",
                                  .type = "system_modes_msgs/srv/ChangeMode"};
  const auto server = ServiceServer::Create(
      *manager, service, [](absl::string_view request) { return std::string(request); });
  ASSERT_THAT(server, IsOk());
  const auto client = ServiceClient::Create(*actuator, service);
  ASSERT_THAT(client, IsOk());
  const auto reply = (*client)->Call(Message(), absl::Seconds(20));
  ASSERT_THAT(reply, IsOk());
  EXPECT_EQ(*reply, Message());
}

}  // namespace
}  // namespace rips::dds
