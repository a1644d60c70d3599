#pragma once

#include "CoreMinimal.h"
#include "Subsystems/GameInstanceSubsystem.h"

#include "ArmbridgeSubsystem.generated.h"

class FArmbridgeConnection;

/** The connections of a game, one a server, however many components use it. */
UCLASS()
class ARMBRIDGE_API UArmbridgeSubsystem : public UGameInstanceSubsystem
{
	GENERATED_BODY()

public:
	/** Stops every connected arm along its path and ends all its goals. Returns false if none is connected. */
	UFUNCTION(BlueprintCallable, Category = "armbridge")
	bool StopAll();

	/** Returns the connection to a server; the first caller opens it. */
	TSharedRef<FArmbridgeConnection> Connect(const FString& Url, const FString& Token);

	virtual void Deinitialize() override;

private:
	TMap<FString, TSharedPtr<FArmbridgeConnection>> Connections;
};
